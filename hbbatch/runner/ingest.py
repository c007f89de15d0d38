"""Logs and folders into the dataset: what is new or changed is read, the rest is left alone."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from hbbatch.dataset import Dataset
from hbbatch.errors import ExitStatus, HbbatchError, SourceError, status_of
from hbbatch.runner.ingest_catalog import CatalogRows, NamesInUse, put_rows
from hbbatch.runner.ingest_task import (
    Brought,
    IngestStatus,
    IngestTask,
    SequenceOutcome,
    bring_up_to_date,
)
from hbbatch.runner.opened import open_all
from hbbatch.runner.processes import begin_in_pool, in_pool, interrupts_blocked
from hbbatch.sources.base import SequenceHandle, Source, SourceOptions

__all__ = ["IngestReport", "IngestStatus", "SequenceOutcome", "ingest"]

_NO_OPTIONS: Final = SourceOptions()


@dataclass
class IngestReport:
    """What an ingest did.

    Attributes:
        dataset_root: where it was written.
        outcomes: one a sequence, in the order of the sources.
        source_errors: why whole sources could not be read.
        dropped: sequences that a source does not hold any more, by source.
        seconds: how long it took.
    """

    dataset_root: Path
    outcomes: list[SequenceOutcome] = field(default_factory=list)
    source_errors: list[SourceError] = field(default_factory=list)
    dropped: dict[Path, list[str]] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def errors(self) -> list[str]:
        """Everything that failed, one line each."""
        return [error for _, error in self.failures]

    @property
    def failures(self) -> list[tuple[str, str]]:
        """The same with the id of the sequence it is about, empty where it is a whole source."""
        return [("", str(error)) for error in self.source_errors] + self._failed_sequences

    @property
    def _failed_sequences(self) -> list[tuple[str, str]]:
        return [(o.sequence_id, o.error) for o in self.outcomes if o.error is not None]

    @property
    def notices(self) -> list[str]:
        """What was removed from the dataset, one line a source."""
        return [
            f"{source} does not hold {', '.join(gone)} any more: removed from the dataset (tracks "
            "of former runs are kept)"
            for source, gone in self.dropped.items()
        ]

    @property
    def exit_status(self) -> ExitStatus:
        """What the process should tell the shell."""
        if self._failed_sequences:
            return ExitStatus.FAILED
        if self.source_errors:
            return status_of(self.source_errors)
        partial = any(outcome.partial for outcome in self.outcomes)
        return ExitStatus.DATA_LOSS if partial else ExitStatus.DONE


def ingest(
    sources: Sequence[Path],
    dataset_root: Path,
    *,
    options: SourceOptions = _NO_OPTIONS,
    force: bool = False,
    workers: int = 1,
    on_outcome: Callable[[SequenceOutcome], None] = lambda _: None,
) -> IngestReport:
    """Read sources into a dataset, which is made if there is none.

    A sequence whose source has not changed is left alone; one that fails keeps its former tables
    and does not stop the others. One that its source does not hold any more is dropped, unless
    topics were chosen: then it may be of another choice.

    Args:
        sources: logs, folders of a known format, or folders with any of these below.
        dataset_root: the dataset folder.
        options: what the user says about the sources.
        force: read unchanged sequences again, and let a sequence replace one of another source.
        workers: processes that read; with one, this process does.
        on_outcome: called when a sequence is done.

    Raises:
        DatasetError: the dataset cannot be written, or was written by a newer version.
        UsageError: an option names a file or release that cannot be used, or is of no use.
        HbbatchError: a worker process ended before its time.
    """
    started = time.perf_counter()
    report = IngestReport(dataset_root)
    opened = open_all(sources, options)
    found = [
        (source, handle)
        for source in opened.sources
        for handle in opened.ask(source.path, source.sequences) or ()
    ]
    report.source_errors = opened.errors
    if found:
        dataset = Dataset.create(dataset_root)
        tasks = _tasks(dataset, found, options, force)
        outcomes: dict[int, list[SequenceOutcome]] = {}
        for number, brought in _brought(tasks, workers):
            put_rows(dataset, tasks[number].source, brought.rows, brought.gone)
            outcomes[number] = brought.outcomes
            for outcome in brought.outcomes:
                on_outcome(outcome)
        report.outcomes = [outcome for number in sorted(outcomes) for outcome in outcomes[number]]
        if not options.topics:
            report.dropped = _gone(dataset, tasks)
            for source, gone in report.dropped.items():
                put_rows(dataset, source, [], gone)
    report.seconds = time.perf_counter() - started
    return report


def _tasks(
    dataset: Dataset,
    found: Sequence[tuple[Source, SequenceHandle]],
    options: SourceOptions,
    force: bool,
) -> list[IngestTask]:
    rows = CatalogRows(dataset.catalog().to_pylist())
    named = [(handle.sequence_id, source.path) for source, handle in found]
    names, others = NamesInUse(rows, named), set(named)
    return [
        IngestTask(
            dataset=dataset,
            source=source.path,
            source_format=source.format_name,
            handle=handle,
            former=rows.of(handle.sequence_id, source.path, others),
            rivals=names.rivals(number),
            classes=options.classes,
            force=force,
        )
        for number, (source, handle) in enumerate(found)
    ]


def _gone(dataset: Dataset, tasks: Sequence[IngestTask]) -> dict[Path, list[str]]:
    """Sequences of the dataset that their sources, as read now, do not hold any more."""
    rows = CatalogRows(dataset.catalog().to_pylist())
    held: dict[Path, set[str]] = {}
    for task in tasks:
        own = rows.of(task.handle.sequence_id, task.source)
        held.setdefault(task.source, set()).update(row["sequence_id"] for row in own)
    gone = {
        source: [r["sequence_id"] for r in rows.of_source(source) if r["sequence_id"] not in ids]
        for source, ids in held.items()
    }
    return {source: ids for source, ids in gone.items() if ids}


def _brought(tasks: Sequence[IngestTask], workers: int) -> Iterator[tuple[int, Brought]]:
    """What became of each task, by its number, as they end."""
    if workers <= 1 or len(tasks) <= 1:
        yield from enumerate(map(bring_up_to_date, tasks))
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(
        min(workers, len(tasks)), mp_context=context, initializer=begin_in_pool
    )
    try:
        with interrupts_blocked():
            futures = [pool.submit(in_pool, bring_up_to_date, task) for task in tasks]
            numbers = {future: number for number, future in enumerate(futures)}
        for done in as_completed(numbers):
            yield numbers[done], done.result()
    except BrokenProcessPool as error:
        raise HbbatchError(
            "a worker process was killed, perhaps for want of memory. What was ingested is kept: "
            "run the same command again, with fewer --workers."
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)
