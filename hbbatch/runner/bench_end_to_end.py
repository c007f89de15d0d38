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
from hbbatch.runner.measured import Command, measured
from hbbatch.runner.repeated import repeated_dataset
from hbbatch.tracking.workload import copy_rate, sgemm_rate


@dataclass(frozen=True)
class _Way:
    """A way to do the work.

    Attributes:
        workers: worker processes of a command.
        cores: that a command is kept to (None: all).
        commands: at once, each with its part of the sequences and cores of its own.
    """

    workers: int
    cores: int | None
    commands: int = 1

    @property
    def cores_shown(self) -> str:
        return "all" if self.cores is None else str(self.cores)

    def cores_of(self, number: int) -> list[int] | None:
        """The cores of one of the commands."""
        if self.cores is None or not hasattr(os, "sched_getaffinity"):
            return None
        there = sorted(os.sched_getaffinity(0))
        return there[number * self.cores :][: self.cores] or there[: self.cores]


_ONE_CORE: Final = _Way(1, 1)
_ONE_WORKER: Final = _Way(1, None)
_TWO_WORKERS: Final = _Way(2, 2)
_TWO_COMMANDS: Final = _Way(1, 1, commands=2)
"""Two processes that have nothing to do with each other: what this machine gives two at best."""


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
            costs: dict[_Way, list[_Cost]] = {way: [] for way in _ways(count)}
            for turn in range(runs):
                for number, way in enumerate(costs):
                    costs[way].append(_run(dataset, f"{turn}-{number}", settings, way))
            rows += _rows(count, costs)
    return Table(
        "`hbbatch track` end to end, start of Python and of the workers counted",
        (
            *("sequences", "frames", "commands", "workers", "cores", "runs"),
            *("median s", "best s", "CPU s", "cores busy"),
            *("frames/s", "x one worker", "x one worker on one core", "peak MB a worker"),
        ),
        rows,
        "The ways to run took turns; ratios are medians of those within a turn. One worker on "
        "all cores reads and writes on a second core while it steps; on one core it cannot. "
        "Two commands at once share nothing but the machine, each with half of the sequences and a "
        "core of its own: what two workers can gain at best. Cores busy are processor time over "
        "time.",
    )


def _ways(sequences: int) -> list[_Way]:
    ways = [_ONE_WORKER, _TWO_WORKERS]
    if not hasattr(os, "sched_setaffinity"):
        return ways
    return [_ONE_CORE, *ways, *([_TWO_COMMANDS] if sequences > 1 else [])]


def _rows(count: int, costs: dict[_Way, list[_Cost]]) -> Iterator[tuple[str, ...]]:
    for way, several in costs.items():
        median_s = statistics.median(c.wall_s for c in several)
        yield (
            *(f"{count:,}", f"{several[0].frames:,}", str(way.commands)),
            *(str(way.workers), way.cores_shown, str(len(several))),
            *(f"{median_s:.2f}", f"{min(c.wall_s for c in several):.2f}"),
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
    ids = dataset.sequence_ids()
    runs = [f"{name}-{number}" for number in range(way.commands)]
    commands = []
    for number, run in enumerate(runs):
        part = ids[number :: way.commands] if way.commands > 1 else []
        line = _command_line(dataset, run, settings, way.workers)
        commands.append(Command([*line, *part], way.cores_of(number)))
    os.sync()  # what earlier runs wrote is not this one's to wait for
    done = measured(commands)
    for ended in done.ended:
        if ended.returncode not in (0, 3):
            raise HbbatchError(
                f"hbbatch track ended with {ended.returncode}: {ended.stderr.strip()}"
            )
    frames = sum(int(json.loads(ended.stdout)["frames"]) for ended in done.ended)
    peak = max(_peak_rss_mb(dataset, run) for run in runs)
    return _Cost(done.wall_s, done.cpu_s, frames, peak)


def _command_line(dataset: Dataset, run: str, settings: TrackSettings, workers: int) -> list[str]:
    line = [sys.executable, "-m", "hbbatch", "track", "--dataset", str(dataset.root)]
    line += ["--workers", str(workers), "--run", run, "--filter", settings.filter]
    line += ["--device", "cpu", "--json"]
    return line if settings.weights is None else [*line, "--weights", settings.weights]


def _peak_rss_mb(dataset: Dataset, run: str) -> float:
    timing = read_table(dataset.run(run).timing, schema.TIMING, "timing table of the run")
    return max(timing["peak_rss_mb"].to_pylist(), default=0.0)


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
