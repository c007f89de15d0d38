"""One recording of a source brought up to date in a dataset; runs in any process."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from hbbatch import schema
from hbbatch.dataset import Dataset
from hbbatch.dataset.store import check_name
from hbbatch.errors import DatasetError, HbbatchError, SequenceError, report_defect
from hbbatch.runner.ingest_catalog import Rival
from hbbatch.runner.ingest_tables import write_sequence
from hbbatch.runner.memory import keep_freed_memory
from hbbatch.sources.base import SequenceHandle, source_errors
from hbbatch.sources.classes import load_taxonomy

INGEST_VERSION: Final = 6
"""Raised when the same source would give other tables or problems, so that it is read again."""


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


@dataclass(frozen=True)
class IngestTask:
    """A recording to bring up to date.

    Attributes:
        dataset: where to.
        source: file or folder it is in.
        source_format: name of its format.
        handle: the recording.
        former: its rows of the catalogue.
        rivals: others that have its name, or that of a part it may be divided into.
        classes: file that extends the table of class names.
        force: whether to read it although it has not changed, or to replace another source's.
    """

    dataset: Dataset
    source: Path
    source_format: str
    handle: SequenceHandle
    former: Sequence[dict[str, Any]]
    rivals: Sequence[Rival]
    classes: Path | None
    force: bool


@dataclass
class Brought:
    """What became of a task.

    Attributes:
        outcomes: one a sequence.
        rows: catalogue rows that are new.
        gone: sequences of former rows that the recording does not give any more.
    """

    outcomes: list[SequenceOutcome] = field(default_factory=list)
    rows: list[dict[str, Any]] = field(default_factory=list)
    gone: list[str] = field(default_factory=list)


def _are_there(dataset: Dataset, rows: list[dict[str, Any]]) -> bool:
    """Whether the tables that catalogue rows speak of still are where they were written.

    Those of an ingest that was stopped before it came to the catalogue are others.
    """
    tables = {"poses", "labels"}
    return all(
        dataset.path(table, row["sequence_id"]).is_file()
        for row in rows
        for table in (tables if row["labels"] else tables - {"labels"})
    ) and all(_made_of(dataset, row["sequence_id"]) == row["source_hash"] for row in rows)


def _made_of(dataset: Dataset, sequence_id: str) -> str | None:
    """Source hash of a sequence's tables; None where it cannot be told."""
    try:
        return dataset.source_hash(sequence_id)
    except DatasetError:
        return None


def bring_up_to_date(task: IngestTask) -> Brought:
    """Read a recording if it is new or has changed, and write its tables.

    The catalogue is left to the caller. A recording that fails leaves its former tables.

    Raises:
        DatasetError: the dataset cannot be written.
    """
    started = time.perf_counter()
    name = task.handle.sequence_id
    try:
        with source_errors(task.source):
            check_name(name, f"{task.source}: sequence")
            source_hash = _source_hash(task)
            _refuse_taken(task, [name], source_hash)
            same = [row for row in task.former if row["source_hash"] == source_hash]
            if same and not task.force and _are_there(task.dataset, same):
                seconds = time.perf_counter() - started
                unchanged = IngestStatus.UNCHANGED
                return Brought([_outcome(task, unchanged, row, seconds) for row in same])
            return _write(task, source_hash)
    except DatasetError:
        raise
    except Exception as failure:  # noqa: BLE001 - whatever is wrong with one must not stop others
        said = str(failure)
        if not isinstance(failure, HbbatchError):
            said = f"{task.source}: sequence {name}: {report_defect(failure)}"
        kept = " The dataset keeps what it had of this sequence." if task.former else ""
        seconds = time.perf_counter() - started
        error = f"{said}{kept}"
        failed = SequenceOutcome(name, task.source, IngestStatus.FAILED, seconds, None, error)
        return Brought([failed])


def _outcome(
    task: IngestTask, status: IngestStatus, row: dict[str, Any], seconds: float
) -> SequenceOutcome:
    return SequenceOutcome(row["sequence_id"], task.source, status, seconds, row)


def _write(task: IngestTask, source_hash: str) -> Brought:
    """Write the tables of all sequences of a recording; all of them or none that is new."""
    keep_freed_memory()
    taxonomy = load_taxonomy(task.classes)
    former = {row["sequence_id"] for row in task.former}
    brought = Brought()
    started = time.perf_counter()
    try:
        readings = task.handle.read()
        _refuse_taken(task, [reading.sequence_id for reading in readings], source_hash)
        for reading in readings:
            row = {
                "source": str(task.source.resolve()),
                "source_format": task.source_format,
                **write_sequence(task.dataset, task.source, source_hash, reading, taxonomy),
            }
            brought.rows.append(row)
            status = (
                IngestStatus.REPLACED if row["sequence_id"] in former else IngestStatus.INGESTED
            )
            ended = time.perf_counter()
            brought.outcomes.append(_outcome(task, status, row, ended - started))
            started = ended
    except Exception:
        for row in brought.rows:
            if row["sequence_id"] not in former:
                task.dataset.drop_sequence(row["sequence_id"])
        raise
    brought.gone = sorted(former - {row["sequence_id"] for row in brought.rows})
    return brought


def _source_hash(task: IngestTask) -> str:
    classes = hashlib.sha256(task.classes.read_bytes()).hexdigest() if task.classes else None
    parts = (
        INGEST_VERSION,
        schema.FORMAT_VERSION,
        task.source_format,
        task.handle.fingerprint(),
        classes,
    )
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def _refuse_taken(task: IngestTask, names: Collection[str], source_hash: str) -> None:
    """Refuse names of sequences that another recording has.

    Raises:
        SequenceError: one of the same command or, unless forced, of an earlier one. A recording
            that has only been moved is the same one.
    """
    for rival in task.rivals:
        if rival.sequence_id not in names:
            continue
        if rival.source_hash is None:
            raise SequenceError(
                f"{task.source}: sequence {rival.sequence_id} is also in {rival.source}. Ingest "
                "one of them into another dataset (--dataset)."
            )
        if rival.source_hash != source_hash and not task.force:
            raise SequenceError(
                f"{task.source}: the dataset has a sequence {rival.sequence_id} already, from "
                f"{rival.source}. Use another dataset (--dataset), or --force to replace it."
            )
