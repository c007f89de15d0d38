"""Logs and folders into the dataset: what is new or changed is read, the rest is left alone."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from hbbatch import schema
from hbbatch.dataset import Dataset
from hbbatch.dataset.store import check_name
from hbbatch.errors import ExitStatus, SequenceError, SourceError, UsageError
from hbbatch.runner.ingest_tables import write_sequence
from hbbatch.sources.base import SequenceHandle, Source, SourceOptions, source_errors
from hbbatch.sources.detect import open_sources

INGEST_VERSION: Final = 1
"""Raised when the same source would give other tables, so that it is read again."""


class IngestStatus(StrEnum):
    """What happened to a sequence."""

    INGESTED = "ingested"
    REPLACED = "replaced"
    UNCHANGED = "unchanged"
    FAILED = "failed"


@dataclass(frozen=True)
class SequenceOutcome:
    """What happened to one sequence.

    Attributes:
        sequence_id: its name.
        source: the file or folder it is in.
        status: what happened.
        seconds: how long it took.
        row: its catalogue row; None when it failed.
        error: why it failed.
    """

    sequence_id: str
    source: Path
    status: IngestStatus
    seconds: float
    row: dict[str, Any] | None = None
    error: str | None = None

    @property
    def partial(self) -> bool:
        """Whether the source was damaged and part of it is lost."""
        return self.row is not None and bool(self.row["partial"])

    @property
    def problems(self) -> list[str]:
        """What was odd in the source."""
        return [] if self.row is None else list(self.row["problems"])


@dataclass
class IngestReport:
    """What an ingest did.

    Attributes:
        dataset_root: where it was written.
        outcomes: one a sequence, in order.
        source_errors: why whole sources could not be read, one line each.
        seconds: how long it took.
    """

    dataset_root: Path
    outcomes: list[SequenceOutcome] = field(default_factory=list)
    source_errors: list[str] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def errors(self) -> list[str]:
        """Everything that failed, one line each."""
        return self.source_errors + [o.error for o in self.outcomes if o.error is not None]

    @property
    def exit_status(self) -> ExitStatus:
        """What the process should tell the shell."""
        if self.errors:
            return ExitStatus.FAILED
        partial = any(outcome.partial for outcome in self.outcomes)
        return ExitStatus.DATA_LOSS if partial else ExitStatus.DONE


def ingest(
    sources: Sequence[Path],
    dataset_root: Path,
    *,
    detections: Path | None = None,
    topics: Sequence[str] = (),
    force: bool = False,
    on_outcome: Callable[[SequenceOutcome], None] = lambda _: None,
) -> IngestReport:
    """Read sources into a dataset, which is made if there is none.

    A sequence whose source has not changed is left alone; one that fails keeps its former tables
    and does not stop the others.

    Args:
        sources: logs, folders of a known format, or folders with any of these below.
        dataset_root: the dataset folder.
        detections: folder of detections, for formats that keep them apart.
        topics: detection topics to read from logs.
        force: read unchanged sequences again, and let a sequence replace one of another source.
        on_outcome: called when a sequence is done.

    Raises:
        DatasetError: the dataset cannot be written, or was written by a newer version.
    """
    started = time.perf_counter()
    report = IngestReport(dataset_root)
    found = list(_sequences(sources, SourceOptions(detections, tuple(topics)), report))
    if found:
        dataset = Dataset.create(dataset_root)
        former = {row["sequence_id"]: row for row in dataset.catalog().to_pylist()}
        owners: dict[str, Path] = {}
        for source, handle in found:
            outcome = _ingest_sequence(
                dataset, source, handle, former.get(handle.sequence_id), owners, force
            )
            report.outcomes.append(outcome)
            on_outcome(outcome)
    report.seconds = time.perf_counter() - started
    return report


def _sequences(
    paths: Sequence[Path], options: SourceOptions, report: IngestReport
) -> Iterator[tuple[Source, SequenceHandle]]:
    """All sequences of all sources; a source that cannot be read is an entry in the report."""
    for path in paths:
        try:
            opened = open_sources(path, options)
        except SourceError as error:
            report.source_errors.append(str(error))
            continue
        for source in opened:
            try:
                with source_errors(source.path):
                    handles = source.sequences()
            except SourceError as error:
                report.source_errors.append(str(error))
                continue
            yield from ((source, handle) for handle in handles)


def _ingest_sequence(
    dataset: Dataset,
    source: Source,
    handle: SequenceHandle,
    former: dict[str, Any] | None,
    owners: dict[str, Path],
    force: bool,
) -> SequenceOutcome:
    """Bring one sequence up to date; `former` is its row of the catalogue before."""
    started = time.perf_counter()
    row, error = None, None
    try:
        with source_errors(source.path):
            check_name(handle.sequence_id, f"{source.path}: sequence")
            source_hash = _source_hash(source, handle)
            _check_owner(source, handle, owners, former, source_hash, force)
            if former is not None and former["source_hash"] == source_hash and not force:
                status, row = IngestStatus.UNCHANGED, former
            else:
                status = IngestStatus.REPLACED if former else IngestStatus.INGESTED
                row = _write(dataset, source, handle, source_hash)
    except (SourceError, SequenceError, UsageError) as failure:
        kept = " The dataset keeps what it had of this sequence." if former else ""
        status, error = IngestStatus.FAILED, f"{failure}{kept}"
    seconds = time.perf_counter() - started
    return SequenceOutcome(handle.sequence_id, source.path, status, seconds, row, error)


def _write(
    dataset: Dataset, source: Source, handle: SequenceHandle, source_hash: str
) -> dict[str, Any]:
    """Write the tables of a sequence, and last its catalogue row, which is returned."""
    row = {
        "sequence_id": handle.sequence_id,
        "source": str(source.path.resolve()),
        "source_format": source.format_name,
        "source_hash": source_hash,
        **write_sequence(dataset, source.path, handle),
    }
    _put_catalog_row(dataset, row)
    return row


def _source_hash(source: Source, handle: SequenceHandle) -> str:
    parts = (INGEST_VERSION, schema.FORMAT_VERSION, source.format_name, handle.fingerprint())
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def _check_owner(
    source: Source,
    handle: SequenceHandle,
    owners: dict[str, Path],
    former: dict[str, Any] | None,
    source_hash: str,
    force: bool,
) -> None:
    """Refuse a sequence whose name another source has taken.

    Raises:
        SequenceError: in this command or, unless forced, in an earlier one.
    """
    path = source.path.resolve()
    owner = owners.setdefault(handle.sequence_id, path)
    if owner != path:
        raise SequenceError(
            f"{source.path}: sequence {handle.sequence_id} is also in {owner}. Ingest one of them "
            "into another dataset (--dataset)."
        )
    if former is None or force or former["source_hash"] == source_hash:
        return
    if former["source"] != str(path):
        raise SequenceError(
            f"{source.path}: the dataset has a sequence {handle.sequence_id} already, from "
            f"{former['source']}. Use another dataset (--dataset), or --force to replace it."
        )


def _put_catalog_row(dataset: Dataset, row: dict[str, Any]) -> None:
    """Add or replace a row; the catalogue is read again since others may have written to it."""
    others = dataset.catalog().filter(pc.field("sequence_id") != row["sequence_id"])
    added = pa.Table.from_pylist([row], schema=schema.CATALOG)
    dataset.write_catalog(pa.concat_tables([others, added]))
