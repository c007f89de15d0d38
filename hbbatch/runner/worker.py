"""What a worker does with its sequences: read, step them together, write each when it ends."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from hbbatch import schema
from hbbatch.config import DeviceName, TrackSettings
from hbbatch.dataset import Dataset, Run, write_aside
from hbbatch.dataset.store import write_json, write_table
from hbbatch.errors import HbbatchError, UsageError
from hbbatch.projection import Camera
from hbbatch.runner.plan import Group, SequenceJob
from hbbatch.runner.timing import TimingRow, timing_row
from hbbatch.sinks.kitti import kitti_result
from hbbatch.tracking.frames import SequenceFrames, sequence_frames
from hbbatch.tracking.tracks import TrackedSequence, tracks_table


class BatchTracker(Protocol):
    """The part of `tracking.engine.Tracker` that a worker uses."""

    class_names: tuple[str, ...]

    def track(self, group: Sequence[SequenceFrames]) -> Iterator[TrackedSequence]:
        """Step all sequences of a group together; each is yielded when it is done."""


@dataclass(frozen=True)
class LoadedTracker:
    """A tracker and the device it is on (cpu or cuda)."""

    tracker: BatchTracker
    device: str


LoadTracker = Callable[[TrackSettings, DeviceName], LoadedTracker]


@dataclass(frozen=True)
class Order:
    """What every worker of a run is told; small and picklable, heavy things are made from it."""

    dataset: Dataset
    run: Run
    settings: TrackSettings
    device: DeviceName
    load_tracker: LoadTracker


@dataclass(frozen=True)
class Outcome:
    """What became of a sequence: a timing row when it is done, an error when it failed."""

    sequence_id: str
    timing: TimingRow | None = None
    error: str | None = None


def load_tracker(settings: TrackSettings, device: DeviceName) -> LoadedTracker:
    """The tracker on a device; from here on this process computes in one thread.

    Raises:
        UsageError: cuda is asked for and there is none.
        WeightsError: the weights are missing, damaged or of another version.
    """
    import torch

    from hbbatch.tracking.engine import Tracker

    check_device(device)
    torch.set_num_threads(1)
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    return LoadedTracker(Tracker(settings, torch.device(device)), device)


def check_device(device: DeviceName) -> None:
    """Refuse cuda where there is none.

    Raises:
        UsageError: cuda is asked for and there is none.
    """
    if device != "cuda":
        return
    import torch

    if not torch.cuda.is_available():
        raise UsageError("no CUDA device is available here. Use --device cpu or --device auto.")


def track_group(
    order: Order, loaded: LoadedTracker, group: Group, worker: int
) -> Iterator[Outcome]:
    """Track sequences together and write each when it ends; one outcome a sequence, always.

    A sequence that cannot be read or written fails alone. If stepping the group fails, the
    sequences not yet done are stepped one by one, so that only the culprit fails.
    """
    readings, waiting = [], {}
    for job in group:
        try:
            reading = _read(order, loaded.tracker.class_names, job)
        except Exception as error:  # noqa: BLE001 - whatever is wrong with one must not stop others
            yield _failure(job, error)
        else:
            readings.append(reading)
            waiting[job.sequence_id] = (job, reading)
    try:
        for tracked in loaded.tracker.track([reading.frames for reading in readings]):
            job, reading = waiting.pop(tracked.frames.sequence_id)
            yield _finish(order, loaded, _Finished(job, tracked, reading.seconds, worker))
        _all_came_back(waiting)
    except Exception as error:  # noqa: BLE001 - as above
        if len(waiting) == 1:
            yield _failure(next(iter(waiting.values()))[0], error)
        else:
            for job, _ in waiting.values():
                yield from track_group(order, loaded, (job,), worker)


def _all_came_back(waiting: Mapping[str, object]) -> None:
    if waiting:
        raise RuntimeError("the tracker gave no result")


@dataclass(frozen=True)
class _Reading:
    frames: SequenceFrames
    seconds: float


@dataclass(frozen=True)
class _Finished:
    job: SequenceJob
    tracked: TrackedSequence
    read_s: float
    worker: int


def _read(order: Order, class_names: Sequence[str], job: SequenceJob) -> _Reading:
    started = time.perf_counter()
    frames = sequence_frames(
        job.sequence_id,
        order.dataset.detections(job.sequence_id),
        order.dataset.poses(job.sequence_id),
        class_names,
        order.settings.min_score,
    )
    return _Reading(frames, time.perf_counter() - started)


def _finish(order: Order, loaded: LoadedTracker, finished: _Finished) -> Outcome:
    try:
        return Outcome(finished.job.sequence_id, timing=_write(order, loaded, finished))
    except Exception as error:  # noqa: BLE001 - a full disk or a bad calibration of one sequence
        return _failure(finished.job, error)


def _write(order: Order, loaded: LoadedTracker, finished: _Finished) -> TimingRow:
    """Outputs first, status last; the old status goes before anything it vouches for changes."""
    started = time.perf_counter()
    run, sequence_id = order.run, finished.job.sequence_id
    remove_status(run, sequence_id)
    tracked = finished.tracked
    table = tracks_table(tracked, loaded.tracker.class_names)
    result = kitti_result(table, _camera(order.dataset, sequence_id))
    write_table(run.tracks(sequence_id), table, schema.TRACKS)
    with write_aside(run.kitti(sequence_id)) as aside:
        aside.write_bytes(result)
    write_s = time.perf_counter() - started
    timing = timing_row(tracked, finished.read_s, write_s, loaded.device, finished.worker)
    write_status(run, sequence_id, {"state": "done", "key": finished.job.key, "timing": timing})
    return timing


def _camera(dataset: Dataset, sequence_id: str) -> Camera | None:
    calibration = dataset.calibration(sequence_id)
    if calibration is None:
        return None
    return Camera.from_calibration(calibration, str(dataset.calibration_path(sequence_id)))


def write_status(run: Run, sequence_id: str, status: dict[str, Any]) -> None:
    """Say in the run's folder what became of a sequence."""
    write_json(run.status(sequence_id), {"sequence_id": sequence_id, **status})


def remove_status(run: Run, sequence_id: str) -> None:
    """Take back what was said of a sequence.

    Raises:
        HbbatchError: the folder cannot be written.
    """
    try:
        run.status(sequence_id).unlink(missing_ok=True)
    except OSError as error:
        raise HbbatchError(
            f"{run.status(sequence_id)}: cannot be replaced ({error.strerror}). "
            "Check the folder's permissions."
        ) from error


def _failure(job: SequenceJob, error: Exception) -> Outcome:
    text = " ".join(str(error).split())
    if not isinstance(error, HbbatchError):
        text = f"{type(error).__name__}: {text}"
    return Outcome(job.sequence_id, error=text)
