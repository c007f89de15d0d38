"""What tracking a group takes: seconds by stage, rows stepped, multiply-adds of the network.

Used by `hbbatch bench`; refining and files are not part of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits
from torch import nn

from hbbatch.config import TrackSettings
from hbbatch.model.weights import build_loaded
from hbbatch.model.weights_files import open_weights
from hbbatch.packed import kernels
from hbbatch.tracking.eager_steps import eager_steps
from hbbatch.tracking.engine import stepping
from hbbatch.tracking.frames import SequenceFrames
from hbbatch.tracking.lockstep import LockStep
from hbbatch.tracking.pieces import cut
from hbbatch.tracking.plain import track_plainly
from hbbatch.tracking.schedule import schedule
from hbbatch.tracking.steps import MakeSteps
from hbbatch.tracking.tracks import StageSeconds

Way = Literal["engine's own", "eager torch modules"]


@dataclass(frozen=True)
class Effort:
    """What stepping a group took.

    Attributes:
        seconds: all in all.
        stages: the same by stage.
        steps: lock steps.
        predicted: track steps predicted.
        updated: track steps corrected by a detection.
    """

    seconds: float
    stages: StageSeconds
    steps: int
    predicted: int
    updated: int


class Workload:
    """A filter ready to be measured, in one thread."""

    def __init__(self, settings: TrackSettings) -> None:
        """Load the filter that the settings name."""
        file = open_weights(settings.filter, settings.weights, settings.classes)
        self.class_names = file.class_names
        self._settings = settings
        self._motion = build_loaded(file).eval()
        self._kinds = np.array(file.kind_codes)
        self.ways: dict[Way, MakeSteps] = {"engine's own": stepping(file, "cpu")}
        if kernels.AVAILABLE:
            self.ways["eager torch modules"] = eager_steps(file, "cpu")

    def step(self, group: Sequence[SequenceFrames], way: Way = "engine's own") -> Effort:
        """Track a group in lock step."""
        start = perf_counter()
        plan = schedule([piece.frames for piece in cut(group, self._settings.management)])
        steps = self.ways[way](plan, self._kinds[plan.class_codes], self._settings)
        stages = StageSeconds.total(share for _, _, share in LockStep(plan, steps).run())
        seconds = perf_counter() - start
        return Effort(seconds, stages, plan.steps, steps.predicted, steps.corrected)

    def step_plainly(self, frames: SequenceFrames) -> float:
        """Seconds that the plain loop takes for a sequence."""
        start = perf_counter()
        track_plainly(frames, self._motion, self._kinds, self._settings)
        return perf_counter() - start

    def bytes_moved(self, effort: Effort) -> int:
        """The least that stepping reads and writes.

        The networks' weights once a step, and of each track's row and box what was and what
        becomes of it, once to predict and once to correct.
        """
        row_bytes = 4 * self._motion.width + 8 * 7
        weights_bytes = 4 * sum(self.multiply_adds())
        return effort.steps * weights_bytes + 2 * row_bytes * (effort.predicted + effort.updated)

    def multiply_adds(self) -> tuple[int, int]:
        """Of the network, for one track: to predict and to correct.

        A read-out that was not learned says nothing and is not worked out.
        """
        parts = dict(self._motion.named_children())
        return _weights(parts.get("residual")), _weights(parts.get("gain"))


def sgemm_rate(rows: int, inner: int, columns: int, seconds: float = 0.3) -> float:
    """Multiply-adds a second of float32 matrix products of a size, in this thread."""
    threadpool_limits(1, user_api="blas")
    first = np.ones((rows, inner), np.float32)
    second, product = np.ones((inner, columns), np.float32), np.empty((rows, columns), np.float32)
    taken_s = _median_s(lambda: np.matmul(first, second, out=product), seconds)
    return rows * inner * columns / taken_s


def copy_rate(size_bytes: int, seconds: float = 0.3) -> float:
    """Bytes a second that this thread reads and writes when it copies so many."""
    source, target = np.ones(size_bytes // 4, np.float32), np.empty(size_bytes // 4, np.float32)
    return 2 * source.nbytes / _median_s(lambda: np.copyto(target, source), seconds)


def _median_s(work: Callable[[], object], seconds: float) -> float:
    times: list[float] = []
    end = perf_counter() + seconds
    while perf_counter() < end or len(times) < 5:
        start = perf_counter()
        work()
        times.append(perf_counter() - start)
    return float(np.median(times))


def _weights(part: nn.Module | None) -> int:
    if part is None:
        return 0
    matrices = (parameter for parameter in part.parameters() if parameter.dim() == 2)
    return sum(matrix.numel() for matrix in matrices if matrix.any())
