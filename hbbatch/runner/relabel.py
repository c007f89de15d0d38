"""Ingest, track and evaluate what a job file names; what is up to date is left alone."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hbbatch.dataset import Dataset, Run
from hbbatch.dataset.store import write_json
from hbbatch.errors import ExitStatus, HbbatchError, status_of
from hbbatch.runner.evaluate import EvaluationReport, evaluate
from hbbatch.runner.ingest import IngestReport, IngestStatus, ingest
from hbbatch.runner.jobfile import RelabelJob
from hbbatch.runner.plan import select
from hbbatch.runner.status import read_status
from hbbatch.runner.track import (
    HYBRIDTRACK,
    Engine,
    Progress,
    TrackReport,
    TrackRequest,
    track,
)
from hbbatch.sources.base import SourceOptions


@dataclass(frozen=True)
class RelabelReport:
    """What a job came to.

    Attributes:
        dataset: folder of the dataset.
        ingested: one report a source, in the order of the file.
        tracked: None when no sequence could be ingested.
        evaluated: None when there are no labels or the scores in the run folder are current.
        problems: what went wrong outside of single sequences.
    """

    dataset: Path
    ingested: tuple[IngestReport, ...]
    tracked: TrackReport | None
    evaluated: EvaluationReport | None
    problems: tuple[str, ...]

    @property
    def unchanged(self) -> bool:
        """Whether there was nothing to do."""
        statuses = {o.status for report in self.ingested for o in report.outcomes}
        idle = self.tracked is not None and not (self.tracked.tracked or self.tracked.failed)
        return idle and statuses == {IngestStatus.UNCHANGED} and not (self.evaluated or self.errors)

    @property
    def errors(self) -> list[str]:
        """Everything that failed before evaluation, one line each."""
        return [error for _, error in self.failures]

    @property
    def failures(self) -> list[tuple[str, str]]:
        """The same with the id of the sequence that each is about, empty where it is none."""
        found = [failure for report in self.ingested for failure in report.failures]
        if self.tracked is not None:
            found += self.tracked.failures
        return [*found, *(("", problem) for problem in self.problems)]

    @property
    def exit_status(self) -> ExitStatus:
        """What the process tells the shell."""
        if not any(report.outcomes for report in self.ingested):
            errors = [error for report in self.ingested for error in report.source_errors]
            return status_of(errors) if errors else ExitStatus.DONE
        if self.errors or (self.evaluated is not None and self.evaluated.failed):
            return ExitStatus.FAILED
        return self.tracked.exit_status if self.tracked else ExitStatus.DONE

    def to_json(self) -> dict[str, Any]:
        """The same as plain values."""
        outcomes = [outcome for report in self.ingested for outcome in report.outcomes]
        return {
            "dataset": str(self.dataset),
            "ingested": {outcome.sequence_id: outcome.status.value for outcome in outcomes},
            "tracked": self.tracked and self.tracked.to_json(),
            "evaluated": self.evaluated and self.evaluated.to_json(),
            "unchanged": self.unchanged,
            "errors": self.errors,
            "exit_status": int(self.exit_status),
        }


def relabel(
    job: RelabelJob,
    command: str = "",
    progress: Progress | None = None,
    engine: Engine = HYBRIDTRACK,
) -> RelabelReport:
    """Run a job to its end; a source or sequence that fails is reported and stops no other.

    Raises:
        DatasetError: the dataset cannot be written, or was written by a newer version.
        UsageError: the device is not there.
    """
    ingested = tuple(
        ingest([s.path], job.dataset, options=SourceOptions(s.detections, s.topics))
        for s in job.sources
    )
    outcomes = [outcome for report in ingested for outcome in report.outcomes]
    ids = sorted({outcome.sequence_id for outcome in outcomes if outcome.error is None})
    if not ids:
        return RelabelReport(job.dataset, ingested, None, None, ())
    request = TrackRequest(
        job.dataset, job.track, tuple(ids), job.run, job.device, job.workers, command
    )
    tracked = track(request, progress, engine)
    done = [*tracked.tracked, *tracked.up_to_date]
    evaluated, problems = (
        _evaluate(Dataset(job.dataset), tracked.run, done) if job.evaluate else (None, ())
    )
    return RelabelReport(job.dataset, ingested, tracked, evaluated, problems)


def _evaluate(
    dataset: Dataset, run_name: str, ids: Sequence[str]
) -> tuple[EvaluationReport | None, tuple[str, ...]]:
    """Score the labelled sequences, unless the run folder holds their scores already."""
    run = dataset.run(run_name)
    rows = select(dataset.catalog(), ids) if ids else []
    labelled = {row["sequence_id"]: row["source_hash"] for row in rows if row["labels"]}
    key = _evaluation_key(run, labelled)
    if not labelled or _read_key(run) == key:
        return None, ()
    try:
        report = evaluate(dataset.root, run.name, sorted(labelled))
    except HbbatchError as error:
        return None, (f"{error} To go without scores, set `evaluate: false`.",)
    if not report.failed:
        write_json(_scores_path(run), {"key": key, **report.to_json()})
    return report, ()


def _evaluation_key(run: Run, labelled: dict[str, str]) -> str:
    """Hash of what decides the scores: the sources, labels included, and what tracks were made."""
    parts = [(i, source, read_status(run, i).get("key")) for i, source in sorted(labelled.items())]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]


def _scores_path(run: Run) -> Path:
    return run.root / "evaluation.json"


def _read_key(run: Run) -> str | None:
    try:
        key: str | None = json.loads(_scores_path(run).read_text()).get("key")
    except (OSError, ValueError, AttributeError):
        return None
    return key
