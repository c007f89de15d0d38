"""How fast tracking is here, against a plain loop and against what this core can compute.

Everything runs in one thread of this process but the end-to-end runs, which are the command line's
own. Figures are medians of several runs, and ratios are of figures taken in the same call: absolute
ones depend on the machine and on what else it does.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info

from hbbatch.config import TrackSettings
from hbbatch.dataset import Dataset, Run
from hbbatch.errors import HbbatchError
from hbbatch.packed.kernels import AVAILABLE
from hbbatch.runner.bench_end_to_end import end_to_end, start_up, two_at_once
from hbbatch.runner.bench_report import Table
from hbbatch.runner.orders import LoadedTracker, Order, load_tracker
from hbbatch.runner.plan import job_of
from hbbatch.runner.timing import peak_rss_mb
from hbbatch.runner.worker import track_group
from hbbatch.tracking.frames import SequenceFrames, sequence_frames
from hbbatch.tracking.workload import Effort, Way, Workload, copy_rate, sgemm_rate

_STAGES = ("predict", "associate", "update", "manage")
_PLAIN_FRAMES = 100
CROWDS = (10, 50, 200, 1000)
BUSY_CROWD = 200
STEPPING_S = 4.0
"""For so long at least each set is stepped again and again."""


@dataclass(frozen=True)
class BenchRequest:
    """What to measure.

    Attributes:
        datasets: folders of datasets, each measured by itself.
        end_to_end: datasets to run `hbbatch track` on, together; none skips it.
        settings: filter and all else that decides the tracks.
        runs: repetitions of each measurement.
        repeats: how often the first dataset is repeated to see that cost is linear.
        sequences: how many sequences to run `hbbatch track` on, each number by itself.
    """

    datasets: tuple[Path, ...]
    end_to_end: tuple[Path, ...]
    settings: TrackSettings
    runs: int = 5
    repeats: tuple[int, ...] = (1, 10)
    sequences: tuple[int, ...] = (50,)


def bench(request: BenchRequest, progress: Callable[[str], None]) -> list[Table]:
    """Measure; `progress` is told what is being measured."""
    workload = Workload(request.settings)
    groups = {path.name: _frames(path, workload.class_names) for path in request.datasets}
    measures: dict[str, Callable[[], Table]] = {
        "this machine": partial(_machine, workload),
        "stepping": partial(_compute, request, workload, groups),
        "other ways to step": partial(_ways, request, workload, groups),
        "crowds": partial(_crowds, request, workload),
        "repeated sequences": partial(_scaling, request, workload, groups),
        "files": partial(_files, request),
        "start-up": partial(start_up, request.runs),
        "two processes at once": two_at_once,
        "end to end": partial(
            end_to_end, request.end_to_end, request.sequences, request.settings, request.runs
        ),
    }
    tables = []
    for what, measure in measures.items():
        progress(what)
        table = measure()
        load = f"Load of the machine at the end of this measurement: {os.getloadavg()[0]:.1f}."
        tables.append(replace(table, note=f"{table.note} {load}".lstrip()))
    return [table for table in tables if table.rows]


def _frames(path: Path, class_names: Sequence[str]) -> list[SequenceFrames]:
    dataset = Dataset.open(path)
    return [
        sequence_frames(i, dataset.detections(i), dataset.poses(i), class_names)
        for i in dataset.sequence_ids()
    ]


def _machine(workload: Workload) -> Table:
    predict, update = workload.multiply_adds()
    big, small = sgemm_rate(1024, 1024, 1024), sgemm_rate(128, 95, 100)
    return Table(
        "This core",
        ("figure", "value"),
        [
            (
                "compiled kernels",
                "in use" if AVAILABLE else "not built: torch steps, numpy matches",
            ),
            ("numpy multiplies with", _products()),
            ("float32 matrix product, 1024³", f"{big / 1e9:.1f} G multiply-adds/s"),
            ("float32 matrix product, 128 x 95 x 100", f"{small / 1e9:.1f} G multiply-adds/s"),
            ("copy of 64 MB, bytes read and written", f"{copy_rate(64_000_000) / 1e9:.1f} GB/s"),
            ("network, to predict one track", f"{predict:,} multiply-adds"),
            ("network, to correct one track", f"{update:,} multiply-adds"),
        ],
    )


def _products() -> str:
    """The libraries numpy multiplies with, and for which processors the code is that they chose."""
    found = threadpool_info()
    libraries = [library for library in found if library["user_api"] == "blas"]
    return ", ".join(
        f"{library['internal_api']} {library['version']} ({library.get('architecture', 'any')})"
        for library in libraries
    )


def _compute(
    request: BenchRequest, workload: Workload, groups: dict[str, list[SequenceFrames]]
) -> Table:
    crowd = [synthetic_crowd(BUSY_CROWD, 60, seed) for seed in range(4)]
    rows = [
        _compute_row(name, group, workload, request.runs)
        for name, group in {**groups, f"synthetic, {BUSY_CROWD} tracks a frame": crowd}.items()
    ]
    return Table(
        "Stepping, one thread, files not counted",
        (
            *("detections", "frames", "track steps", "rows a step", "ms a step", "frames/s"),
            *("track steps/s", *_STAGES, "x plain loop", "x arithmetic floor"),
            *("multiply-adds a step", "bytes a step", "x copy floor"),
        ),
        rows,
        "The plain loop steps one sequence at a time and one track at a time, with the same filter "
        "and costs; it is measured on the start of each set, in the same run. The arithmetic floor "
        "is the network's multiply-adds at the rate of a 1024³ product, the better of two that are "
        "measured before and after a run. The copy floor: the least "
        "to be read and written (weights once a step, each track's row and box once to predict and "
        "once to correct) at the rate of a copy of 64 MB.",
    )


def _compute_row(
    name: str, group: list[SequenceFrames], workload: Workload, runs: int
) -> tuple[str, ...]:
    effort, over_floor = _measured(group, workload, runs)
    frames = _frame_count(group)
    shares = [getattr(effort.stages, stage) / effort.seconds for stage in _STAGES]
    rate = frames / effort.seconds
    moved, multiplied = workload.bytes_moved(effort), _multiply_adds(effort, workload)
    start = _head(group[0], _PLAIN_FRAMES)
    plain = start.frame_count / workload.step_plainly(start)
    return (
        *(name, f"{frames:,}", f"{effort.predicted:,}"),
        *(f"{effort.predicted / effort.steps:.0f}", f"{1e3 * effort.seconds / effort.steps:.2f}"),
        *(f"{rate:,.0f}", f"{effort.predicted / effort.seconds:,.0f}"),
        *(f"{share:.0%}" for share in shares),
        *(f"{rate / plain:,.0f}", over_floor),
        *(f"{multiplied / effort.steps:,.0f}", f"{moved / effort.steps:,.0f}"),
        f"{effort.seconds / (moved / copy_rate(64_000_000)):.0f}",
    )


def _multiply_adds(effort: Effort, workload: Workload) -> int:
    predict, update = workload.multiply_adds()
    return predict * effort.predicted + update * effort.updated


def _measured(group: Sequence[SequenceFrames], workload: Workload, runs: int) -> tuple[Effort, str]:
    """The median effort, and how many times the arithmetic floor: the median, too.

    A core changes pace, so there are so many runs at least and as many as fill some seconds, its
    rate is taken before and after each, and the better one counts.
    """
    rates, efforts = [_rate()], list[Effort]()
    end = time.perf_counter() + STEPPING_S
    while len(efforts) < runs or time.perf_counter() < end:
        efforts.append(workload.step(group))
        rates.append(_rate())
    paces = zip(efforts, map(max, rates, rates[1:]), strict=True)
    needed = _multiply_adds(efforts[0], workload)
    over = median(effort.seconds * rate for effort, rate in paces) / needed if needed else None
    return _median(efforts), "-" if over is None else f"{over:.1f}"


def _rate() -> float:
    return sgemm_rate(1024, 1024, 1024, seconds=0.1)


def _ways(
    request: BenchRequest, workload: Workload, groups: dict[str, list[SequenceFrames]]
) -> Table:
    rows = []
    for name, group in groups.items():
        efforts: dict[Way, list[Effort]] = {way: [] for way in workload.ways}
        for _ in range(max(request.runs // 2, 1)):  # turn about, so that load hits both
            for way in workload.ways:
                efforts[way].append(workload.step(group, way))
        found = {label: _median(several) for label, several in efforts.items()}
        fastest = min(effort.seconds for effort in found.values())
        for label, effort in found.items():
            rate = _frame_count(group) / effort.seconds
            rows.append((name, label, f"{rate:,.0f}", f"{effort.seconds / fastest:.2f}"))
    columns = ("detections", "filter", "frames/s", "x fastest")
    return Table("Ways to step the filter on a CPU", columns, rows)


def _crowds(request: BenchRequest, workload: Workload) -> Table:
    rows = []
    for tracks in CROWDS:
        group = [synthetic_crowd(tracks, max(20, 4000 // tracks), seed=0)]
        effort = _median([workload.step(group) for _ in range(request.runs)])
        per_track = 1e6 / effort.predicted
        rows.append(
            (
                *(f"{tracks:,}", f"{_frame_count(group) / effort.seconds:,.0f}"),
                *(f"{getattr(effort.stages, stage) * per_track:.1f}" for stage in _STAGES),
                f"{effort.seconds * per_track:.1f}",
            )
        )
    return Table(
        "One sequence, growing crowd of the same density",
        ("tracks a frame", "frames/s", *(f"{s}, µs a track" for s in _STAGES), "all, µs a track"),
        rows,
        "What a track costs falls until the fixed cost of a step no longer shows, then stays: "
        "association grows with neighbours, not with tracks x detections.",
    )


def synthetic_crowd(tracks: int, frames: int, seed: int) -> SequenceFrames:
    """Cars that drive straight on an area of 100 m² a car; one in twenty detections is missing."""
    rng = np.random.default_rng(seed)
    boxes = np.tile([0.0, 0.0, 0.8, 4.5, 1.8, 1.5, 0.0], (frames, tracks, 1))
    boxes[..., 6] = rng.uniform(-np.pi, np.pi, tracks)
    speed = rng.uniform(0, 12, tracks) * 0.1 * np.arange(frames)[:, None]
    start = rng.uniform(0, 10.0 * np.sqrt(tracks), (tracks, 2))
    boxes[..., 0] = start[:, 0] + speed * np.cos(boxes[..., 6])
    boxes[..., 1] = start[:, 1] + speed * np.sin(boxes[..., 6])
    boxes += rng.normal(0, 0.05, boxes.shape)
    seen = rng.random((frames, tracks)) < 0.95
    kept = boxes[seen]
    return SequenceFrames(
        sequence_id=f"crowd-{tracks}-{seed}",
        timestamp_ns=np.arange(frames) * 100_000_000,
        offsets=np.concatenate([[0], np.cumsum(seen.sum(axis=1))]),
        boxes=kept,
        sight_m=kept[:, :3].copy(),
        scores=np.ones(len(kept)),
        class_codes=np.zeros(len(kept), np.int64),
        detection_ids=np.arange(len(kept)),
        rotation=np.tile(np.eye(3), (frames, 1, 1)),
        translation_m=np.zeros((frames, 3)),
    )


def _scaling(
    request: BenchRequest, workload: Workload, groups: dict[str, list[SequenceFrames]]
) -> Table:
    rows = []
    for name, group in list(groups.items())[:1]:
        cases = {"1": group[:1]} | {str(n * len(group)): list(group) * n for n in request.repeats}
        for count, repeated in cases.items():
            several = [replace(f, sequence_id=f"{i}") for i, f in enumerate(repeated)]
            effort, over_floor = _measured(several, workload, request.runs)
            frames = _frame_count(several)
            rate = f"{frames / effort.seconds:,.0f}"
            rows.append((name, count, f"{frames:,}", rate, over_floor))
    columns = ("detections", "sequences", "frames", "frames/s", "x arithmetic floor")
    return Table("The same sequences repeated, one group", columns, rows)


def _files(request: BenchRequest) -> Table:
    """A worker's whole work on a dataset, by stage."""
    loaded = load_tracker(request.settings, "cpu")
    rows = []
    for path in request.datasets:
        timings, wall_s = _one_worker(path, request.settings, loaded)
        frames = sum(row["frames"] for row in timings)
        stages = ("read", *_STAGES, "write")
        busy = {stage: sum(row[f"{stage}_s"] for row in timings) for stage in stages}
        rows.append(
            (
                *(path.name, f"{frames:,}", f"{frames / wall_s:,.0f}"),
                *(f"{seconds:.2f}" for seconds in busy.values()),
                f"{peak_rss_mb():.0f}",
            )
        )
    return Table(
        "One worker from Parquet to Parquet, KITTI text and status, start-up not counted",
        (
            *("detections", "frames", "frames/s of wall time", "read s"),
            *(f"{stage} s" for stage in _STAGES),
            *("write s", "peak RSS MB"),
        ),
        rows,
        "Files are read and written in threads of their own, so the stages add up to more than the "
        "wall time; each includes what it waited for the interpreter.",
    )


def _one_worker(
    path: Path, settings: TrackSettings, loaded: LoadedTracker
) -> tuple[list[dict[str, Any]], float]:
    dataset = Dataset.open(path)
    run = _fresh_run(dataset)
    order = Order(dataset, run, settings, "cpu", load_tracker)
    rows = dataset.catalog().to_pylist()
    jobs = (job_of(row, key="") for row in rows)
    start = time.perf_counter()
    try:
        outcomes = list(track_group(order, loaded, tuple(jobs), worker=0))
        wall_s = time.perf_counter() - start
    finally:
        shutil.rmtree(run.root, ignore_errors=True)
    failed = [outcome for outcome in outcomes if outcome.error is not None]
    if failed:
        raise HbbatchError(f"{path}: {failed[0].sequence_id} failed: {failed[0].error}")
    return [outcome.timing for outcome in outcomes if outcome.timing is not None], wall_s


def _fresh_run(dataset: Dataset) -> Run:
    return dataset.run(f"bench-{os.getpid()}")


def _median(efforts: Iterable[Effort]) -> Effort:
    ordered = sorted(efforts, key=lambda effort: effort.seconds)
    return ordered[len(ordered) // 2]


def _frame_count(group: Sequence[SequenceFrames]) -> int:
    return sum(frames.frame_count for frames in group)


def _head(frames: SequenceFrames, count: int) -> SequenceFrames:
    """The first frames of a sequence."""
    return replace(
        frames, timestamp_ns=frames.timestamp_ns[:count], offsets=frames.offsets[: count + 1]
    )
