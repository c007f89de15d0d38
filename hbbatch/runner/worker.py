"""What a worker does with its sequences: read, step them together, write each when it ends."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Final

import pyarrow as pa

from hbbatch import schema
from hbbatch.dataset import Dataset, write_aside
from hbbatch.dataset.store import table_bytes
from hbbatch.errors import HbbatchError, report_defect
from hbbatch.projection import Camera
from hbbatch.runner.dealing import MAX_PART_DETECTIONS, Group, SequenceJob, bounded
from hbbatch.runner.memory import keep_freed_memory
from hbbatch.runner.orders import LoadedTracker, Order, Outcome
from hbbatch.runner.processes import keep_to
from hbbatch.runner.status import remove_status, write_status
from hbbatch.runner.timing import TimingRow, peak_rss_mb
from hbbatch.sinks.kitti import kitti_result
from hbbatch.tracking.frames import (
    DETECTION_COLUMNS,
    POSE_COLUMNS,
    SequenceFrames,
    sequence_frames,
)
from hbbatch.tracking.tracks import TrackedSequence, tracks_table

_MAX_UNWRITTEN: Final = 8
"""Sequences that have ended and wait for a writer at most."""

_STORERS: Final = 3
"""Threads that put files on the disk, which is nearly all waiting for it."""


def work(pipe: Connection) -> None:
    """What a worker process does: an order comes in by the pipe, then groups; outcomes go out.

    Raises:
        EOFError, OSError: nobody is at the other end any more.
    """
    order, number, cores = pipe.recv()
    keep_to(cores)
    loaded = _load(pipe, order)
    while loaded and (group := pipe.recv()) is not None:
        for outcome in track_group(order, loaded, group, number):
            pipe.send(outcome)
        pipe.send(None)


def _load(pipe: Connection, order: Order) -> LoadedTracker | None:
    try:
        return order.load_tracker(order.settings, order.device)
    except HbbatchError as error:
        pipe.send(error)
    except Exception as error:  # noqa: BLE001 - the parent has to hear of it, whatever it is
        pipe.send(HbbatchError(f"a worker cannot start ({type(error).__name__}: {error})."))
    return None


def track_group(
    order: Order, loaded: LoadedTracker, group: Group, worker: int
) -> Iterator[Outcome]:
    """Track sequences together and write each when it ends; one outcome a sequence, always.

    A group too large for memory is taken in parts. While one part is stepped, the next is read
    and what has ended is written, in threads of their own. Only one of these encodes: more would
    take turns with it at the interpreter.

    A sequence that cannot be read or written fails alone. If stepping the group fails, the
    sequences not yet done are stepped one by one, so that only the culprit fails.
    """
    keep_freed_memory()
    parts = bounded(group, MAX_PART_DETECTIONS)
    with ThreadPoolExecutor(1) as encoder, ThreadPoolExecutor(_STORERS) as storers:
        desk = _Desk(order, loaded, worker, encoder, storers)
        for readings, failures in _read_ahead(order, loaded.tracker.class_names, parts):
            yield from failures
            yield from _track_part(desk, readings)


@dataclass(frozen=True)
class _Desk:
    """What a worker has at hand while stepping a part."""

    order: Order
    loaded: LoadedTracker
    worker: int
    encoder: ThreadPoolExecutor
    storers: ThreadPoolExecutor


def _track_part(desk: _Desk, readings: Sequence[_Reading]) -> Iterator[Outcome]:
    waiting = {reading.job.sequence_id: reading for reading in readings}
    writing: deque[Future[Outcome]] = deque()
    failure: Exception | None = None
    try:
        for tracked in desk.loaded.tracker.track([reading.frames for reading in readings]):
            reading = waiting.pop(tracked.frames.sequence_id)
            encoding = desk.encoder.submit(_encode, desk, tracked, reading.camera)
            writing.append(desk.storers.submit(_finish, desk, reading, encoding))
            while len(writing) > _MAX_UNWRITTEN:
                yield writing.popleft().result()
        _all_came_back(waiting)
    except Exception as error:  # noqa: BLE001 - whatever is wrong with one must not stop others
        failure = error
    for outcome in writing:
        yield outcome.result()
    if failure is not None:
        yield from _one_by_one(desk, list(waiting.values()), failure)


def _one_by_one(desk: _Desk, readings: list[_Reading], failure: Exception) -> Iterator[Outcome]:
    if len(readings) == 1:
        yield _failure(readings[0].job, failure)
        return
    for reading in readings:
        yield from _track_part(desk, [reading])


def _all_came_back(waiting: Mapping[str, object]) -> None:
    if waiting:
        raise RuntimeError("the tracker gave no result")


@dataclass(frozen=True)
class _Reading:
    job: SequenceJob
    frames: SequenceFrames
    camera: Camera | None
    seconds: float


_PartRead = tuple[list[_Reading], list[Outcome]]
"""What could be read of a part, and a failed outcome for each sequence that could not."""


def _read_ahead(
    order: Order, class_names: Sequence[str], parts: Iterable[Group]
) -> Iterator[_PartRead]:
    """Read parts in order; while one is being used, the next is read."""
    with ThreadPoolExecutor(1) as reader:
        coming: Future[_PartRead] | None = None
        for part in parts:
            ready, coming = coming, reader.submit(_read_part, order, class_names, part)
            if ready is not None:
                yield ready.result()
        if coming is not None:
            yield coming.result()


def _read_part(order: Order, class_names: Sequence[str], part: Group) -> _PartRead:
    readings, failures = [], []
    for job in part:
        try:
            readings.append(_read(order, class_names, job))
        except Exception as error:  # noqa: BLE001 - as above
            failures.append(_failure(job, error))
    return readings, failures


def _read(order: Order, class_names: Sequence[str], job: SequenceJob) -> _Reading:
    started = time.perf_counter()
    frames = sequence_frames(
        job.sequence_id,
        order.dataset.detections(job.sequence_id, DETECTION_COLUMNS),
        order.dataset.poses(job.sequence_id, POSE_COLUMNS),
        class_names,
        order.settings.min_score,
    )
    camera = _camera(order.dataset, job.sequence_id)
    # The key of the outputs is that of what the catalogue says, so it had better be right.
    order.dataset.check_tables(job.sequence_id, job.source_hash)
    return _Reading(job, frames, camera, time.perf_counter() - started)


@dataclass(frozen=True)
class _Encoded:
    """A finished sequence and what its files will hold."""

    tracked: TrackedSequence
    table: pa.Buffer
    text: bytes
    seconds: float


def _encode(desk: _Desk, tracked: TrackedSequence, camera: Camera | None) -> _Encoded:
    started = time.perf_counter()
    table = tracks_table(tracked, desk.loaded.tracker.class_names)
    text = kitti_result(table, camera)
    content = table_bytes(table, schema.TRACKS, f"tracks of {tracked.frames.sequence_id}")
    return _Encoded(tracked, content, text, time.perf_counter() - started)


def _finish(desk: _Desk, reading: _Reading, encoding: Future[_Encoded]) -> Outcome:
    try:
        return Outcome(reading.job.sequence_id, timing=_store(desk, reading, encoding.result()))
    except Exception as error:  # noqa: BLE001 - a full disk or a bad calibration of one sequence
        return _failure(reading.job, error)


def _store(desk: _Desk, reading: _Reading, encoded: _Encoded) -> TimingRow:
    """Outputs first, status last; the old status goes before anything it vouches for changes."""
    started = time.perf_counter()
    run, job = desk.order.run, reading.job
    remove_status(run, job.sequence_id)
    with write_aside(run.tracks(job.sequence_id)) as aside:
        aside.write_bytes(encoded.table)
    with write_aside(run.kitti(job.sequence_id)) as aside:
        aside.write_bytes(encoded.text)
    write_s = encoded.seconds + time.perf_counter() - started
    timing = _timing_row(encoded.tracked, reading.seconds, write_s, desk.loaded.device, desk.worker)
    done = {"state": "done", "key": job.key, "recipe": desk.order.recipe, "timing": timing}
    write_status(run, job.sequence_id, done)
    return timing


def _camera(dataset: Dataset, sequence_id: str) -> Camera | None:
    calibration = dataset.calibration(sequence_id)
    if calibration is None:
        return None
    return Camera.from_calibration(calibration, str(dataset.calibration_path(sequence_id)))


def _failure(job: SequenceJob, error: Exception) -> Outcome:
    text = str(error) if isinstance(error, HbbatchError) else report_defect(error)
    return Outcome(job.sequence_id, error=" ".join(text.split()))


def _timing_row(
    tracked: TrackedSequence, read_s: float, write_s: float, device: str, worker: int
) -> TimingRow:
    """The row of a sequence that was just written."""
    seconds = {"read_s": read_s, "write_s": write_s}
    seconds |= {f"{stage}_s": float(value) for stage, value in vars(tracked.seconds).items()}
    wall_s = sum(seconds.values())
    frames = tracked.frames.frame_count
    return {
        "sequence_id": tracked.frames.sequence_id,
        "frames": frames,
        "detections": len(tracked.frames.boxes),
        "tracks": tracked.tracks.track_count,
        **seconds,
        "wall_s": wall_s,
        "frames_per_s": frames / wall_s if wall_s else 0.0,
        "device": device,
        "worker": worker,
        "peak_rss_mb": peak_rss_mb(),
    }
