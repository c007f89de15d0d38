"""How long `hbbatch track` takes from the shell's point of view, with one worker and with two.

Everything is made in a temporary folder and removed at the end only: a file system that looks for
recently deleted files makes the next run pay for it.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Final

import numpy as np

from hbbatch import schema
from hbbatch.config import TrackSettings
from hbbatch.dataset import Dataset
from hbbatch.dataset.store import read_table
from hbbatch.errors import HbbatchError
from hbbatch.runner.bench_report import Table
from hbbatch.runner.measured import measured
from hbbatch.runner.repeated import repeated_dataset
from hbbatch.tracking.workload import copy_rate, sgemm_rate


@dataclass(frozen=True)
class _Way:
    """A way to run the command: worker processes, and cores it is kept to (None: all)."""

    workers: int
    cores: int | None

    @property
    def cores_shown(self) -> str:
        return "all" if self.cores is None else str(self.cores)


_ONE_CORE: Final = _Way(1, 1)
_ONE_WORKER: Final = _Way(1, None)
_TWO_WORKERS: Final = _Way(2, 2)


@dataclass(frozen=True)
class _Cost:
    """What one run of the command took."""

    wall_s: float
    cpu_s: float
    frames: int
    peak_rss_mb: float


def end_to_end(
    sources: Sequence[Path], sequences: Sequence[int], settings: TrackSettings, runs: int
) -> Table:
    """`hbbatch track` over the sequences of some datasets, repeated until there are enough.

    Args:
        sources: datasets.
        sequences: how many sequences to run on, each number by itself.
        settings: filter and all else that decides the tracks.
        runs: repetitions; the ways to run take turns, so that load hits all of them.
    """
    rows: list[tuple[str, ...]] = []
    with tempfile.TemporaryDirectory(prefix="hbbatch-bench-") as folder:
        for count in sequences if sources else ():
            dataset = repeated_dataset(sources, Path(folder) / str(count), count)
            costs: dict[_Way, list[_Cost]] = {way: [] for way in _ways()}
            for turn in range(runs):
                for number, way in enumerate(costs):
                    costs[way].append(_run(dataset, f"{turn}-{number}", settings, way))
            rows += _rows(count, costs)
    return Table(
        "`hbbatch track` end to end, start of Python and of the workers counted",
        (
            *("sequences", "frames", "workers", "cores", "runs", "median s", "best s", "CPU s"),
            "cores busy",
            *("frames/s", "x one worker", "x one worker on one core", "peak MB a worker"),
        ),
        rows,
        "The ways to run took turns; ratios are medians of those within a turn. One worker on "
        "all cores reads and writes on a second core while it steps; on one core it cannot. "
        "Cores busy are processor time over time: what a second worker gains where both cores keep "
        "their pace, but for what it takes to start.",
    )


def _ways() -> list[_Way]:
    ways = [_ONE_WORKER, _TWO_WORKERS]
    return [_ONE_CORE, *ways] if hasattr(os, "sched_setaffinity") else ways


def _rows(count: int, costs: dict[_Way, list[_Cost]]) -> Iterator[tuple[str, ...]]:
    for way, several in costs.items():
        median_s = statistics.median(c.wall_s for c in several)
        yield (
            *(f"{count:,}", f"{several[0].frames:,}", str(way.workers), way.cores_shown),
            *(str(len(several)), f"{median_s:.2f}", f"{min(c.wall_s for c in several):.2f}"),
            f"{statistics.median(c.cpu_s for c in several):.2f}",
            f"{statistics.median(c.cpu_s / c.wall_s for c in several):.2f}",
            f"{several[0].frames / median_s:,.0f}",
            f"{_gain(costs[_ONE_WORKER], several):.2f}",
            f"{_gain(costs[_ONE_CORE], several):.2f}" if _ONE_CORE in costs else "-",
            f"{max(c.peak_rss_mb for c in several):.0f}",
        )


def _gain(before: Sequence[_Cost], after: Sequence[_Cost]) -> float:
    """How many times as fast one way is as another: a machine that others use changes pace."""
    turns = zip(before, after, strict=True)
    return statistics.median(one.wall_s / other.wall_s for one, other in turns)


def _run(dataset: Dataset, name: str, settings: TrackSettings, way: _Way) -> _Cost:
    arguments = ["track", "--dataset", str(dataset.root), "--workers", str(way.workers)]
    arguments += ["--run", name, "--filter", settings.filter, "--device", "cpu", "--json"]
    if settings.weights is not None:
        arguments += ["--weights", settings.weights]
    os.sync()  # what earlier runs wrote is not this one's to wait for
    with _kept_to(way.cores):
        done = measured([sys.executable, "-m", "hbbatch", *arguments])
    if done.status not in (0, 3):
        raise HbbatchError(f"hbbatch track ended with {done.status}: {done.stderr.strip()}")
    timing = read_table(dataset.run(name).timing, schema.TIMING, "timing table of the run")
    peak = max(timing["peak_rss_mb"].to_pylist(), default=0.0)
    frames = int(json.loads(done.stdout)["frames"])
    return _Cost(done.wall_s, done.cpu_s, frames, peak)


@contextmanager
def _kept_to(cores: int | None) -> Iterator[None]:
    """Processes started inside run on so many cores only, where the system can do that."""
    if cores is None or not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(before)[:cores])
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


_START: Final = """
from hbbatch.config import TrackSettings
from hbbatch.runner.worker import work
from hbbatch.tracking.engine import Tracker
Tracker(TrackSettings(), "cpu")
"""
"""What a worker does before its first sequence."""


def start_up(runs: int) -> Table:
    """Seconds from the start of Python to a tracker that is ready."""
    ways = {
        "worker on a CPU": _START,
        "worker that loads torch as well": f"import torch\n{_START}",
        "`hbbatch --help`": "import sys; sys.argv[1:] = ['--help']\n"
        "from hbbatch.cli.main import main\nmain()",
    }
    seconds: dict[str, list[float]] = {what: [] for what in ways}
    for _ in range(runs):
        for what, code in ways.items():
            start = time.perf_counter()
            subprocess.run(  # noqa: S603 - our own code
                [sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL
            )
            seconds[what].append(time.perf_counter() - start)
    rows = [(what, f"{statistics.median(several):.2f}") for what, several in seconds.items()]
    return Table("Start of a process until it can track", ("process", "s"), rows)


def two_at_once() -> Table:
    """What two processes get of this machine together, as a multiple of what one gets alone."""
    jobs = {
        "float32 matrix product, 1024³": partial(sgemm_rate, 1024, 1024, 1024, 1.0),
        "float32 matrix product, 128 x 95 x 100": partial(sgemm_rate, 128, 95, 100, 1.0),
        "copy of 64 MB": partial(copy_rate, 64_000_000, 1.0),
        "numpy operations on 100 numbers": partial(_small_operations, 1.0),
    }
    rows = []
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for what, job in jobs.items():
            for future in [pool.submit(job), pool.submit(job)]:  # both processes are up
                future.result()
            alone = pool.submit(job).result()
            both = [future.result() for future in [pool.submit(job), pool.submit(job)]]
            rows.append((what, f"{sum(both) / alone:.2f}"))
    return Table(
        "Two processes at once",
        ("work", "together, x one alone"),
        rows,
        "What two workers can gain at most here: where it is below 2, the cores share what the "
        "work needs, or another process had its part of them.",
    )


def _small_operations(seconds: float) -> float:
    """Operations a second whose cost is their number, as in a step with few rows."""
    values = np.ones(100, np.float32)
    done, end = 0, time.perf_counter() + seconds
    while time.perf_counter() < end:
        for _ in range(1000):
            np.add(values, values)
        done += 1000
    return done / seconds
