"""Track the sequences of a dataset: plan, run, sum up. What `hbbatch track` calls."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from hbbatch import schema
from hbbatch.config import DeviceName, TrackSettings
from hbbatch.dataset import Dataset, Run, locked
from hbbatch.dataset.store import write_table
from hbbatch.errors import DatasetError, ExitStatus
from hbbatch.model.weights_files import DEFAULT_WEIGHTS, open_weights
from hbbatch.runner.dealing import Group, deal
from hbbatch.runner.device import resolved_device
from hbbatch.runner.executors import Executor, ProcessExecutor, SerialExecutor
from hbbatch.runner.manifest import kept_if_nothing_comes, read_manifest, write_manifest
from hbbatch.runner.orders import LoadTracker, Order, Outcome, load_tracker
from hbbatch.runner.plan import Plan, make_plan, recipe, select
from hbbatch.runner.processes import available_cores
from hbbatch.runner.status import read_status, write_status
from hbbatch.runner.timing import TimingRow, stage_seconds, timing_table

Progress = Callable[[int, int], None]
"""Told the frames done and the frames in all, each time a sequence ends."""


@dataclass(frozen=True)
class TrackRequest:
    """What to track and how.

    Attributes:
        dataset: folder of the dataset.
        settings: everything that decides the tracks.
        sequence_ids: which sequences; all where none is named.
        run: name of the run; by default made from the settings.
        device: where to compute.
        workers: worker processes at most, by default one a core; one is this process itself.
        command: how this was asked for, kept in run.json.
    """

    dataset: Path
    settings: TrackSettings
    sequence_ids: tuple[str, ...] = ()
    run: str | None = None
    device: DeviceName = "auto"
    workers: int | None = None
    command: str = ""


@dataclass(frozen=True)
class Engine:
    """The tracker that is run.

    Attributes:
        weights_hash: the hash of its weights, known without loading it.
        resolved: settings with what they leave to defaults filled in.
        load_tracker: how to load it.
    """

    weights_hash: Callable[[TrackSettings], str]
    resolved: Callable[[TrackSettings], TrackSettings]
    load_tracker: LoadTracker


def weights_hash(settings: TrackSettings) -> str:
    """Hash of the weights that settings name.

    Raises:
        WeightsError: the weights are missing, damaged or of another version.
        UsageError: the weights do not know a class asked for.
    """
    return open_weights(settings.filter, settings.weights, settings.classes).content_hash


def resolved_settings(settings: TrackSettings) -> TrackSettings:
    """Settings with the weights, classes and association threshold that defaults stand for.

    Raises:
        WeightsError: the weights are missing, damaged or of another version.
        UsageError: the weights do not know a class asked for.
    """
    file = open_weights(settings.filter, settings.weights, settings.classes)
    association = settings.association.model_copy(
        update={"max_cost": settings.association.threshold}
    )
    update = {
        "weights": settings.weights or DEFAULT_WEIGHTS[settings.filter],
        "classes": file.class_names,
        "association": association,
    }
    return settings.model_copy(update=update)


HYBRIDTRACK: Final = Engine(weights_hash, resolved_settings, load_tracker)
"""The engine of the package."""


@dataclass(frozen=True)
class TrackReport:
    """What came of it.

    Attributes:
        run: name of the run.
        path: folder of the run's outputs.
        tracked: ids of the sequences tracked now.
        up_to_date: ids of the sequences whose outputs were current already.
        outdated: ids among those tracked now that replaced outputs made from other inputs,
            settings, weights or code.
        failed: what went wrong, by sequence id.
        partial: ids of sequences whose source was damaged, so that part of their data is lost.
        odd: what deserves a look, one line each.
        frames, detections, tracks: sums over the sequences tracked now.
        stage_s: worker seconds by stage, summed over the sequences tracked now.
        wall_s: seconds from start to end, starting the workers included.
        workers: worker processes used.
        device: where it was computed; empty if nothing was.
    """

    run: str
    path: Path
    tracked: tuple[str, ...]
    up_to_date: tuple[str, ...]
    outdated: tuple[str, ...]
    failed: dict[str, str]
    partial: tuple[str, ...]
    odd: tuple[str, ...]
    frames: int
    detections: int
    tracks: int
    stage_s: dict[str, float]
    wall_s: float
    workers: int
    device: str

    @property
    def frames_per_s(self) -> float:
        """Frames per second of wall time: all workers together, their start included."""
        return self.frames / self.wall_s if self.wall_s else 0.0

    @property
    def frames_per_worker_s(self) -> float:
        """Frames per second of one worker's time on its sequences, its start not counted."""
        seconds = sum(self.stage_s.values())
        return self.frames / seconds if seconds else 0.0

    @property
    def failures(self) -> list[tuple[str, str]]:
        """Ids of the sequences that failed, and what to say of each."""
        return [(i, f"sequence {i}: {reason}") for i, reason in sorted(self.failed.items())]

    @property
    def exit_status(self) -> ExitStatus:
        """What the process tells the shell."""
        if self.failed:
            return ExitStatus.FAILED
        return ExitStatus.DATA_LOSS if self.partial else ExitStatus.DONE

    def to_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return {
            **asdict(self),
            "path": str(self.path),
            "frames_per_s": self.frames_per_s,
            "frames_per_worker_s": self.frames_per_worker_s,
            "exit_status": int(self.exit_status),
        }


def default_run_name(settings: TrackSettings) -> str:
    """A name that is the same for the same settings: `hybrid-1a2b3c4d`."""
    return f"{settings.filter}-{settings.digest()}"


def track(
    request: TrackRequest,
    progress: Progress | None = None,
    engine: Engine = HYBRIDTRACK,
) -> TrackReport:
    """Track what is not up to date, and write tracks, result files, timing and manifest.

    Interrupted at any time, the sequences that had ended are whole and are not tracked again.

    Args:
        request: what to track and how.
        progress: is told how far it is.
        engine: the tracker.

    Raises:
        UsageError: an unknown sequence, a bad run name, a device that is not there.
        DatasetError: no dataset, one of a newer version, or a folder that cannot be written.
        WeightsError: the weights are missing, damaged or of another version.
    """
    started = time.perf_counter()
    device = resolved_device(request.device)
    dataset = Dataset.open(request.dataset)
    rows = select(dataset.catalog(), request.sequence_ids)
    name = default_run_name(request.settings) if request.run is None else request.run
    run = dataset.run(name)
    made_before = read_manifest(run).get("recipe")
    weights = engine.weights_hash(request.settings)
    plan = make_plan(rows, run, request.settings, weights)
    asked = request.workers or available_cores()
    groups = deal(plan.to_do, asked)
    workers = min(asked, len(groups))
    made_with = recipe(request.settings, weights)
    outcomes: list[Outcome] = []
    if plan.to_do or made_before != made_with:
        inputs = {row["sequence_id"]: row["content_hash"] for row in rows}
        environment = {"command": request.command, "device": request.device}
        resolved = engine.resolved(request.settings)
        order = Order(dataset, run, request.settings, device, engine.load_tracker, recipe=made_with)
        executor: Executor = SerialExecutor() if asked == 1 else ProcessExecutor(workers)
        # Two runs at once would vouch for each other's outputs.
        with locked(run.root, wait=False):
            ids = [job.sequence_id for job in plan.to_do]
            with kept_if_nothing_comes(run, ids, made_with):
                write_manifest(run, resolved, made_with, weights, inputs, environment)
                outcomes = _execute(order, executor, groups, progress or _silent)
            environment["device"] = _devices(outcomes) or request.device
            with _no_news(outcomes):
                write_manifest(run, resolved, made_with, weights, inputs, environment)
    wall_s = time.perf_counter() - started
    return _report(run, rows, plan, outcomes, _Effort(wall_s, workers))


def _devices(outcomes: Sequence[Outcome]) -> str:
    """Where sequences were computed; empty if none was."""
    return ", ".join(sorted({o.timing["device"] for o in outcomes if o.timing is not None}))


def _silent(_done: int, _total: int) -> None:
    pass


def _execute(
    order: Order, executor: Executor, groups: Sequence[Group], progress: Progress
) -> list[Outcome]:
    """Track groups; whatever happens, the timing table then holds every sequence that ended."""
    jobs = [job for group in groups for job in group]
    frames = {job.sequence_id: job.frames for job in jobs}
    keys = {job.sequence_id: job.key for job in jobs}
    outcomes: list[Outcome] = []
    done = 0
    progress(done, sum(frames.values()))
    try:
        with closing(executor.run(order, groups)) as stream:
            for outcome in stream:
                outcomes.append(outcome)
                done += frames[outcome.sequence_id]
                progress(done, sum(frames.values()))
                if outcome.error is not None:
                    _record_failure(order.run, keys[outcome.sequence_id], outcome)
    finally:
        with _no_news(outcomes):
            _write_timing(order, outcomes)
    return outcomes


@contextmanager
def _no_news(outcomes: Sequence[Outcome]) -> Iterator[None]:
    """On a full disk the tables of the run fail as well: the sequences that did are to be named."""
    try:
        yield
    except DatasetError:
        if not any(outcome.error for outcome in outcomes):
            raise


def _record_failure(run: Run, key: str, outcome: Outcome) -> None:
    status = {"state": "failed", "key": key, "error": outcome.error}
    # On a full disk this fails as well: the failure is in the report, and the others go on.
    with suppress(DatasetError):
        write_status(run, outcome.sequence_id, status)


def _write_timing(order: Order, outcomes: Sequence[Outcome]) -> None:
    """One row for every sequence the run holds: as told now, or by the status files."""
    rows = {outcome.sequence_id: outcome.timing for outcome in outcomes if outcome.timing}
    for sequence_id in order.dataset.sequence_ids():
        if sequence_id not in rows:
            status = read_status(order.run, sequence_id)
            if status.get("state") == "done" and "timing" in status:
                rows[sequence_id] = status["timing"]
    write_table(order.run.timing, timing_table(rows.values()), schema.TIMING)


@dataclass(frozen=True)
class _Effort:
    wall_s: float
    workers: int


def _report(
    run: Run,
    rows: Sequence[dict[str, Any]],
    plan: Plan,
    outcomes: Sequence[Outcome],
    effort: _Effort,
) -> TrackReport:
    timings = [outcome.timing for outcome in outcomes if outcome.timing is not None]
    return TrackReport(
        run=run.name,
        path=run.root,
        tracked=tuple(sorted(timing["sequence_id"] for timing in timings)),
        up_to_date=plan.up_to_date,
        outdated=plan.outdated,
        failed={o.sequence_id: o.error for o in outcomes if o.error is not None},
        partial=tuple(row["sequence_id"] for row in rows if row["partial"]),
        odd=(*_odd_inputs(rows), *_odd_results(timings)),
        frames=sum(timing["frames"] for timing in timings),
        detections=sum(timing["detections"] for timing in timings),
        tracks=sum(timing["tracks"] for timing in timings),
        stage_s=stage_seconds(timings),
        wall_s=effort.wall_s,
        workers=effort.workers,
        device=_devices(outcomes),
    )


def _odd_inputs(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Problems of the sources; one that many sequences share is said once."""
    sequences: dict[str, list[str]] = {}
    for row in rows:
        for problem in row["problems"]:
            sequences.setdefault(problem, []).append(row["sequence_id"])
    return [
        f"{ids[0]}: {problem}" if len(ids) == 1 else f"{len(ids)} sequences: {problem}"
        for problem, ids in sequences.items()
    ]


def _odd_results(timings: Sequence[TimingRow]) -> list[str]:
    empty = sorted(row["sequence_id"] for row in timings if not row["detections"])
    return [f"{', '.join(empty)}: no detection of the classes asked for"] if empty else []
