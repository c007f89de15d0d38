"""Paths of a dataset and typed reading and writing of its tables.

<root>/catalog.parquet
<root>/{detections,poses,labels}/sequence_id=<id>/part-0.parquet
<root>/calibration/sequence_id=<id>/calibration.json
<root>/runs/<run>/run.json, timing.parquet
<root>/runs/<run>/tracks/sequence_id=<id>/part-0.parquet
<root>/runs/<run>/kitti/<id>.txt
<root>/runs/<run>/status/<id>.json            written last: what makes a sequence done
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import unicodedata
from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from hbbatch import schema
from hbbatch.dataset.atomic import write_aside, writing
from hbbatch.errors import DatasetError, UsageError

_SAFE_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
_ARROW_SCHEMA: Final = b"ARROW:schema"
"""Where Parquet files say the types and fields of the Arrow table they were written from."""

_SOURCE_HASH: Final = b"hbbatch_source_hash"
"""Where the detections of a sequence say of what they and the tables beside them were made."""

_VALUES_AT_ONCE: Final = 2**16
_PER_SEQUENCE: Final = ("detections", "poses", "labels", "calibration")


def check_name(name: str, what: str) -> str:
    """`name` itself, when it is safe as the name of a file or folder.

    Raises:
        UsageError: it holds anything but letters, digits, dot, underscore and hyphen.
    """
    if not _SAFE_NAME.fullmatch(name):
        raise UsageError(
            f"{what} {name!r} cannot be a file name. Use letters, digits, '.', '_' and '-' only."
        )
    return name


def safe_name(text: str) -> str:
    """A file name made from any text: accents are dropped, other characters become hyphens.

    A text of which nothing is left is told apart from others by a hash.
    """
    plain = "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", plain).strip("-._")[:128]
    return name or f"unnamed-{hashlib.sha256(text.encode(errors='replace')).hexdigest()[:6]}"


@dataclass(frozen=True)
class Run:
    """Where the outputs of one tracking run lie."""

    root: Path

    @property
    def name(self) -> str:
        """Name of the run."""
        return self.root.name

    @property
    def manifest(self) -> Path:
        """Resolved config, weights hash, code version and inputs of the run."""
        return self.root / "run.json"

    @property
    def timing(self) -> Path:
        """Timing table, a row a sequence."""
        return self.root / "timing.parquet"

    def tracks(self, sequence_id: str) -> Path:
        """Tracks of a sequence."""
        return self.root / "tracks" / f"sequence_id={sequence_id}" / "part-0.parquet"

    def kitti(self, sequence_id: str) -> Path:
        """KITTI result file of a sequence."""
        return self.root / "kitti" / f"{sequence_id}.txt"

    def status(self, sequence_id: str) -> Path:
        """Status file of a sequence."""
        return self.root / "status" / f"{sequence_id}.json"

    def read_tracks(self, sequence_id: str) -> pa.Table:
        """Tracks of a sequence, checked against `schema.TRACKS`."""
        return read_table(
            self.tracks(sequence_id), schema.TRACKS, f"tracks of sequence {sequence_id}"
        )


@dataclass(frozen=True)
class Dataset:
    """A dataset folder. Making one touches no disk; `open` and `create` do."""

    root: Path

    @classmethod
    def open(cls, root: Path) -> Dataset:
        """An existing dataset.

        Raises:
            DatasetError: there is none at `root`, or it was written by a newer version.
        """
        dataset = cls(root)
        if not dataset.catalog_path.is_file():
            raise DatasetError(
                f"{root}: no dataset here (catalog.parquet is missing). Run `hbbatch ingest` "
                "first, or name the dataset with --dataset or $HBBATCH_DATASET."
            )
        dataset.catalog()
        return dataset

    @classmethod
    def create(cls, root: Path) -> Dataset:
        """The dataset at `root`, empty if there was none.

        Raises:
            DatasetError: the folder cannot be written or was written by a newer version.
        """
        dataset = cls(root)
        if dataset.catalog_path.is_file():
            dataset.catalog()
        else:
            dataset.write_catalog(schema.CATALOG.empty_table())
        return dataset

    @property
    def catalog_path(self) -> Path:
        """The catalogue of sequences."""
        return self.root / "catalog.parquet"

    def catalog(self) -> pa.Table:
        """The catalogue, a row a sequence, sorted by id."""
        return read_table(self.catalog_path, schema.CATALOG, "catalogue of the dataset")

    def write_catalog(self, table: pa.Table) -> None:
        """Replace the catalogue."""
        write_table(self.catalog_path, table.sort_by("sequence_id"), schema.CATALOG)

    def source_hashes(self) -> dict[str, str]:
        """What the catalogue says that each sequence was made of, by id, sorted."""
        catalog = self.catalog()
        columns = (catalog[name].to_pylist() for name in ("sequence_id", "source_hash"))
        return dict(zip(*columns, strict=True))

    def sequence_ids(self) -> list[str]:
        """Ids of all sequences, sorted."""
        ids: list[str] = self.catalog()["sequence_id"].to_pylist()
        return ids

    def path(self, table: str, sequence_id: str) -> Path:
        """File of one of the per-sequence tables (detections, poses, labels)."""
        return self.root / table / f"sequence_id={sequence_id}" / "part-0.parquet"

    def calibration_path(self, sequence_id: str) -> Path:
        """Camera calibration of a sequence."""
        return self.root / "calibration" / f"sequence_id={sequence_id}" / "calibration.json"

    def detections(
        self, sequence_id: str, columns: Sequence[str] = schema.DETECTIONS.names
    ) -> pa.Table:
        """Detections of a sequence, all columns or some."""
        return self._read("detections", schema.only(schema.DETECTIONS, columns), sequence_id)

    def poses(self, sequence_id: str, columns: Sequence[str] = schema.POSES.names) -> pa.Table:
        """Poses of a sequence, a row a frame, all columns or some."""
        return self._read("poses", schema.only(schema.POSES, columns), sequence_id)

    def labels(self, sequence_id: str) -> pa.Table | None:
        """Labels of a sequence, None when it has none."""
        if not self.path("labels", sequence_id).is_file():
            return None
        return self._read("labels", schema.LABELS, sequence_id)

    def calibration(self, sequence_id: str) -> dict[str, Any] | None:
        """Camera calibration of a sequence, None when it has none (see docs/formats.md)."""
        path = self.calibration_path(sequence_id)
        if not path.is_file():
            return None
        try:
            content: dict[str, Any] = json.loads(path.read_text())
        except ValueError as error:
            raise DatasetError(
                f"{path}: not valid JSON ({error}). Ingest the sequence again with --force."
            ) from error
        return content

    def source_hash(self, sequence_id: str) -> str | None:
        """What its tables were made of, to compare with the catalogue; None if they do not say.

        The detections carry it, which are only there beside tables of the same time.

        Raises:
            DatasetError: there are no detections, or they cannot be read.
        """
        path = self.path("detections", sequence_id)
        with _reading(path, f"detections of sequence {sequence_id} ({path})") as file:
            said: bytes | None = (file.metadata.metadata or {}).get(_SOURCE_HASH)
        return None if said is None else said.decode()

    def check_tables(self, sequence_id: str, source_hash: str) -> None:
        """Whether the tables as they lie there are those that the catalogue speaks of.

        To be asked when all of them have been read.

        Raises:
            DatasetError: they were made of something else, or the detections cannot be read.
        """
        if self.source_hash(sequence_id) not in {None, source_hash}:
            raise DatasetError(
                f"sequence {sequence_id}: its tables are not those that the catalogue speaks of: "
                "an ingest is at work, or was stopped at it. Ingest its source again."
            )

    def drop_sequence(self, sequence_id: str) -> None:
        """Remove the tables of a sequence (not its catalogue row, nor results of runs)."""
        for table in _PER_SEQUENCE:
            shutil.rmtree(self.root / table / f"sequence_id={sequence_id}", ignore_errors=True)

    def run(self, name: str) -> Run:
        """The run of that name, existing or not."""
        return Run(self.root / "runs" / check_name(name, "run name"))

    def existing_run(self, name: str | None) -> Run:
        """The run of that name, or the latest.

        Raises:
            DatasetError: nothing was tracked yet.
            UsageError: no such run.
        """
        names = self.run_names()
        if not names:
            raise DatasetError(f"{self.root}: nothing was tracked yet. Run `hbbatch track` first.")
        if name is not None and name not in names:
            raise UsageError(f"run {name!r} does not exist. There are: {', '.join(names)}.")
        return self.run(name or names[-1])

    def run_names(self) -> list[str]:
        """Names of all runs, oldest manifest first."""
        manifests = (self.root / "runs").glob("*/run.json")
        return [m.parent.name for m in sorted(manifests, key=lambda m: m.stat().st_mtime_ns)]

    def _read(self, table: str, expected: pa.Schema, sequence_id: str) -> pa.Table:
        path = self.path(table, sequence_id)
        return read_table(path, expected, f"{table} of sequence {sequence_id} ({path})")


def read_table(path: Path, expected: pa.Schema, what: str) -> pa.Table:
    """The columns of a schema from a Parquet file, checked against it.

    Raises:
        DatasetError: the file is missing, damaged or does not fit the schema.
    """
    with _reading(path, what) as file:
        names = set(file.schema_arrow.names)
        there = [name for name in expected.names if name in names]
        # Files are small: one thread is done before others have started.
        table = file.read(there, use_threads=False)
    return schema.conform(table, expected, what)


@contextmanager
def _reading(path: Path, what: str) -> Iterator[pq.ParquetFile]:
    try:
        # Opened here, for Arrow would look up the path's file system each time.
        with pa.memory_map(str(path)) as mapped, pq.ParquetFile(mapped) as file:
            yield file
    except FileNotFoundError as error:
        raise DatasetError(f"{what}: {path} is missing. Ingest the sequence again.") from error
    except (OSError, pa.ArrowException) as error:
        reason = str(error).replace(f" '{path}'", "")
        raise DatasetError(
            f"{what}: {path} cannot be read ({reason}). Restore it, or delete it and make it again."
        ) from error


@contextmanager
def table_writer(path: Path, expected: pa.Schema) -> Iterator[Callable[[pa.Table], None]]:
    """Yield a function that appends a batch to a Parquet file, which is renamed at the end.

    Each batch is checked against the schema; the file appears when the block ends without error.
    Texts may come as dictionaries (`schema.coded`), of which no value is met twice.
    """
    with write_aside(path) as aside, table_into(aside, expected, path) as append:
        yield append


@contextmanager
def table_into(
    aside: Path, expected: pa.Schema, path: Path, source_hash: str | None = None
) -> Iterator[Callable[[pa.Table], None]]:
    """`table_writer` for a file that others rename.

    Args:
        aside: where it is written.
        expected: its schema.
        path: where it will be.
        source_hash: for `Dataset.source_hash`.
    """
    with (
        writing(path),
        pa.OSFile(str(aside), "wb") as file,
        _appending(file, expected, str(path), source_hash) as append,
    ):

        def named(table: pa.Table) -> None:
            with writing(path):
                append(table)

        yield named


def table_bytes(table: pa.Table, expected: pa.Schema, what: str) -> pa.Buffer:
    """What a Parquet file of a table holds; the table is as for `table_writer`."""
    sink = pa.BufferOutputStream()
    with _appending(sink, expected, what) as append:
        append(table)
    return sink.getvalue()


@contextmanager
def _appending(
    sink: pa.NativeFile, expected: pa.Schema, what: str, source_hash: str | None = None
) -> Iterator[Callable[[pa.Table], None]]:
    coded = schema.coded(expected)
    with pq.ParquetWriter(sink, coded, store_schema=False, **_encoding(expected)) as writer:
        yield lambda table: writer.write_table(schema.conform(table, coded, what))
        # Who reads the file gets texts, whatever they were written from.
        told = {_ARROW_SCHEMA: b64encode(expected.serialize())}
        if source_hash is not None:
            told[_SOURCE_HASH] = source_hash.encode()
        writer.add_key_value_metadata({**(expected.metadata or {}), **told})


def _encoding(expected: pa.Schema) -> dict[str, Any]:
    """How columns are written: measured numbers hardly shrink, and differ all."""
    measured = {field.name for field in expected if pa.types.is_floating(field.type)}
    return {
        # On floats, zstd takes three times as long as lz4 to save a tenth.
        "compression": {name: "lz4" if name in measured else "zstd" for name in expected.names},
        # A dictionary of measured numbers is as long as the column.
        "use_dictionary": [f.name for f in expected if pa.types.is_string(f.type)],
        # What counts rows is written as its steps, which are all the same.
        "column_encoding": {
            field.name: "DELTA_BINARY_PACKED"
            for field in expected
            if field.name == "detection_id" and not field.nullable
        },
        # For readers that skip rows by what they are ordered by.
        "write_batch_size": _VALUES_AT_ONCE,
        "write_statistics": [n for n in expected.names if n in {"frame_index", "timestamp_ns"}],
    }


def write_table(path: Path, table: pa.Table, expected: pa.Schema) -> None:
    """Write a Parquet file aside and rename it, checked against a schema."""
    with table_writer(path, expected) as write:
        write(table)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a JSON file aside and rename it."""
    with write_aside(path) as aside:
        aside.write_text(json_text(content))


def json_text(content: dict[str, Any]) -> str:
    """How JSON files are laid out."""
    return json.dumps(content, indent=2, sort_keys=True) + "\n"
