"""One sequence of a source written into the dataset, in batches, all of it or nothing."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from xxhash import xxh3_64_intdigest, xxh3_128

from hbbatch import schema
from hbbatch.boxes import FloatArray
from hbbatch.dataset.atomic import replaced_together, writing
from hbbatch.dataset.store import Dataset, json_text, table_into
from hbbatch.errors import SourceError
from hbbatch.runner.ego_steps import jumps_problem
from hbbatch.sources.base import (
    POSE_ORIGINS,
    CameraCalibration,
    FrameBatch,
    IntArray,
    SequenceReading,
    source_errors,
)
from hbbatch.sources.classes import Taxonomy
from hbbatch.sources.tables import detections_table, labels_table, poses_table

_HASHED_DETECTIONS: Final = [
    field.name
    for field in schema.DETECTIONS
    if field.name
    not in {"timestamp_ns", "detection_id", "frame_id", "class_name_logged", "source_row"}
]
"""Columns of which the content hash is made: the others follow from these and the poses, or are
not read by tracking."""


@dataclass
class Tally:
    """What has been written of a sequence so far."""

    frames: int = 0
    detections: int = 0
    first_ns: int = 0
    last_ns: int = 0
    origins: set[str] = field(default_factory=set)
    unknown_classes: Counter[str] = field(default_factory=Counter)
    translations_m: list[FloatArray] = field(default_factory=list)
    stamps_ns: list[IntArray] = field(default_factory=list)

    def add(self, batch: FrameBatch, taxonomy: Taxonomy) -> None:
        """Count a batch."""
        stamps_ns, origins, names = batch.timestamp_ns, batch.poses.origins, batch.class_names
        self.first_ns = self.first_ns if self.frames else int(stamps_ns[0])
        self.last_ns = int(stamps_ns[-1])
        self.frames += len(stamps_ns)
        self.detections += len(batch.boxes)
        self.translations_m.append(batch.poses.translation_m)
        self.stamps_ns.append(stamps_ns)
        self.origins.update(origins.vocabulary[code] for code in np.unique(origins.codes))
        counts = np.bincount(names.codes, minlength=len(names.vocabulary)).tolist()
        for name, count in zip(names.vocabulary, counts, strict=True):
            if count and not taxonomy.knows(name):
                self.unknown_classes[name] += count

    @property
    def weakest_origin(self) -> str:
        """The least trustworthy way in which a pose was obtained."""
        return max(self.origins, key=POSE_ORIGINS.index)


class ContentHash:
    """Hash of the values that tracking reads, whatever batches they come in.

    It tells tables apart that differ, which is all it is for: it is no proof against forgery.
    """

    def __init__(self) -> None:
        self._columns: dict[str, Any] = {}

    def add(self, prefix: str, table: pa.Table) -> None:
        """Feed a batch of a table."""
        for name in table.column_names:
            column = table[name]
            if table.schema.field(name).nullable:
                self._feed(f"{prefix}.{name}.valid", _valid(column))
                column = column.drop_null()
            if pa.types.is_dictionary(column.type):
                for chunk in column.chunks:
                    self._feed(f"{prefix}.{name}", _text_hashes(chunk))
            else:
                self._feed(f"{prefix}.{name}", column.to_numpy())

    def _feed(self, name: str, values: Any) -> None:
        if name not in self._columns:
            self._columns[name] = xxh3_128()
        self._columns[name].update(np.ascontiguousarray(values))

    def digest(self, calibration: CameraCalibration | None) -> str:
        """The hash, with the calibration."""
        columns = {name: digest.hexdigest() for name, digest in sorted(self._columns.items())}
        content = [columns, calibration.to_json() if calibration else None]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _valid(column: pa.ChunkedArray) -> NDArray[np.bool_]:
    """Which values are not null."""
    if column.null_count == len(column):
        return np.zeros(len(column), dtype=np.bool_)
    valid: NDArray[np.bool_] = column.is_valid().to_numpy()
    return valid


def _text_hashes(column: pa.DictionaryArray) -> NDArray[np.uint64]:
    """A hash of each text, whatever dictionary it is in."""
    hashes = [xxh3_64_intdigest(text.encode()) for text in column.dictionary.to_pylist()]
    of_row: NDArray[np.uint64] = np.array(hashes, dtype=np.uint64)[column.indices.to_numpy()]
    return of_row


def write_sequence(
    dataset: Dataset,
    source: Path,
    source_hash: str,
    reading: SequenceReading,
    taxonomy: Taxonomy,
    labels: pa.Table | None = None,
) -> dict[str, Any]:
    """Write the tables of a sequence; former ones are replaced together, when all has been read.

    Args:
        dataset: where to.
        source: file or folder it is in.
        source_hash: of what it is made.
        reading: the sequence.
        taxonomy: what classes are called.
        labels: in the place of the reading's.

    Returns:
        The columns of its catalogue row that follow from the content, and the hash.

    Raises:
        SourceError: from the reader, or there is no frame.
        OSError: the source cannot be read.
        DatasetError: the dataset cannot be written.
    """
    content, tally = ContentHash(), Tally()
    tables = _counted(reading, source, taxonomy, content, tally)
    if labels is None and reading.labels is not None:
        labels = labels_table(reading.labels, taxonomy)
    _write_tables(dataset, source_hash, reading, tables, labels)
    _note_unknown_classes(reading, tally)
    jumps = jumps_problem(np.concatenate(tally.translations_m), np.concatenate(tally.stamps_ns))
    if jumps is not None:
        reading.findings.note(jumps)
    return {
        "sequence_id": reading.sequence_id,
        "source_hash": source_hash,
        "content_hash": content.digest(reading.calibration),
        "frames": tally.frames,
        "detections": tally.detections,
        "labels": _labelled_boxes(labels),
        "duration_s": (tally.last_ns - tally.first_ns) / 1e9,
        "pose_origin": tally.weakest_origin,
        "partial": reading.findings.partial,
        "problems": list(reading.findings.problems),
    }


def _write_tables(
    dataset: Dataset,
    source_hash: str,
    reading: SequenceReading,
    tables: Iterable[tuple[pa.Table, pa.Table]],
    labels: pa.Table | None,
) -> None:
    """Detections and poses of each batch, then labels and calibration, where there are any."""
    detections, poses, objects = (
        dataset.path(table, reading.sequence_id) for table in ("detections", "poses", "labels")
    )
    calibration = dataset.calibration_path(reading.sequence_id)
    optional = {objects: labels, calibration: reading.calibration}
    written = [detections, poses, *(path for path, given in optional.items() if given is not None)]
    gone = [path for path, given in optional.items() if given is None]
    with replaced_together(written, gone) as asides:
        aside = dict(zip(written, asides, strict=True))
        with (
            table_into(
                aside[detections], schema.DETECTIONS, detections, source_hash
            ) as write_detections,
            table_into(aside[poses], schema.POSES, poses) as write_poses,
        ):
            for of_detections, of_poses in tables:
                write_detections(of_detections)
                write_poses(of_poses)
        if labels is not None:
            with table_into(aside[objects], schema.LABELS, objects) as write_labels:
                write_labels(labels)
        if reading.calibration is not None:
            with writing(calibration):
                aside[calibration].write_text(json_text(reading.calibration.to_json()))


def _counted(
    reading: SequenceReading,
    source: Path,
    taxonomy: Taxonomy,
    content: ContentHash,
    tally: Tally,
) -> Iterator[tuple[pa.Table, pa.Table]]:
    """Detections and poses of each batch, which is hashed and counted.

    Raises:
        SourceError: from the reader, or there is no frame.
    """
    for batch in _guarded(reading.batches, source):
        detections = detections_table(batch, tally.frames, tally.detections, taxonomy)
        poses = poses_table(batch, tally.frames)
        yield detections, poses
        content.add("detections", detections.select(_HASHED_DETECTIONS))
        content.add("poses", poses.drop_columns(["log_time_ns"]))
        tally.add(batch, taxonomy)
    if not tally.frames:
        raise SourceError(
            f"sequence {reading.sequence_id}: no frame could be read. Check the source."
        )


def _guarded(batches: Iterator[FrameBatch], source: Path) -> Iterator[FrameBatch]:
    """Batches; an error of the file system while reading them is the source's, not the output's."""
    with source_errors(source):
        yield from batches


def _labelled_boxes(labels: pa.Table | None) -> int:
    return 0 if labels is None else int((labels["object_id"].to_numpy() >= 0).sum())


def _note_unknown_classes(reading: SequenceReading, tally: Tally) -> None:
    if tally.unknown_classes:
        counted = ", ".join(f"{name!r} ({n})" for name, n in sorted(tally.unknown_classes.items()))
        reading.findings.note(f"classes that are not known, recorded as unknown: {counted}")
