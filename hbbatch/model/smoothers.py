"""What linear smoothing takes off detections when it is fitted to labels: a yardstick for filters.

A linear smoother moves a detection's centre by a weighted sum of where the object's other
detections lie. Its weights are fitted to labels by least absolute error, which no filter is given:
they know the detector's errors, however long these last, and the ego pose's. They are the same for
all objects, so a filter that tells these apart can do better; what it gets beyond the smoother that
sees as much of the future as of the past has to come from there, not from averaging.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import torch
from torch import Tensor

from hbbatch.model.filters import MotionFilter, innovation, moved
from hbbatch.model.horizon import FilterError, mean_error
from hbbatch.model.unroll import unroll
from hbbatch.model.windows import Windows, WindowSet

SIDE_FRAMES: Final = 10
"""Frames that smoothers see before the judged one, and after it."""

_ROUNDS = 40
_SMALLEST_RESIDUAL_M = 0.01
_RIDGE = 0.3
"""Least absolute error as least squares that are weighted again and again (Schlossmacher 1973); the
floor and the ridge keep that stable."""


class Smoother(NamedTuple):
    """A linear smoother.

    Attributes:
        frames: of a window that it sees besides the middle one.
        weights: `(3, frames)` along, across and up.
    """

    frames: tuple[int, ...]
    weights: Tensor


CAUSAL: Final = tuple(range(SIDE_FRAMES))
TWO_SIDED: Final = (*CAUSAL, *range(SIDE_FRAMES + 1, 2 * SIDE_FRAMES + 1))


def dense_windows(data: WindowSet, kind_code: int) -> Windows:
    """All stretches of one kind that hold a detection in each of `2 * SIDE_FRAMES + 1` frames."""
    frames = 2 * SIDE_FRAMES + 1
    long_enough = (data.kind_code == kind_code) & (data.frames_left >= frames)
    windows = data.cut(torch.nonzero(long_enough).flatten(), frames)
    dense = windows.seen.all(dim=1)
    return Windows(*(column[dense] for column in windows))


def fit_smoother(windows: Windows, frames: tuple[int, ...]) -> Smoother:
    """The smoother of least absolute error over dense windows.

    Args:
        windows: from `dense_windows`.
        frames: what it may see.
    """
    missing = innovation(windows.measured[:, SIDE_FRAMES], windows.truth[:, SIDE_FRAMES])
    seen = _displacements(windows, frames)
    return Smoother(
        frames,
        torch.stack([_least_absolute(seen[:, a], missing.motion[:, a]) for a in range(3)]),
    )


def smoothed(windows: Windows, smoother: Smoother) -> Tensor:
    """Boxes `(b, 7)` of the middle frame of dense windows, their centres smoothed."""
    step = (_displacements(windows, smoother.frames) * smoother.weights).sum(dim=2)
    measured = windows.measured[:, SIDE_FRAMES]
    heading = measured[:, 6:7].float()
    motion = torch.nn.functional.pad(step, (0, 1))
    return moved(measured, motion, torch.zeros_like(step), heading.cos(), heading.sin())


@torch.inference_mode()
def middle_posterior(motion: MotionFilter, windows: Windows) -> Tensor:
    """A filter's posteriors `(b, 7)` there, born at the first frame."""
    half = Windows(*(w[:, : SIDE_FRAMES + 1] if w.dim() > 1 else w for w in windows))
    return [step.posterior for step in unroll(motion, half)][-1]


def middle_error(boxes: Tensor, windows: Windows) -> FilterError:
    """Mean errors of boxes of the middle frame."""
    every = torch.ones(len(boxes), dtype=torch.bool)
    return mean_error(boxes, windows, SIDE_FRAMES, every, (1, SIDE_FRAMES, 0))


def _displacements(windows: Windows, frames: tuple[int, ...]) -> Tensor:
    """`(b, 3, frames)` from the middle detection to others, in its heading frame, m."""
    middle = windows.measured[:, SIDE_FRAMES]
    apart = [innovation(middle, windows.measured[:, frame]).motion[:, :3] for frame in frames]
    return torch.stack(apart, dim=2)


def _least_absolute(seen: Tensor, wanted: Tensor) -> Tensor:
    seen, wanted = seen.double(), wanted.double()
    ridge = _RIDGE * torch.eye(seen.shape[1], dtype=seen.dtype)
    weights = seen.new_zeros(seen.shape[1])
    for _ in range(_ROUNDS):
        residual = (wanted - seen @ weights).abs().clamp(min=_SMALLEST_RESIDUAL_M)
        scaled = seen / residual[:, None]
        weights = torch.linalg.solve(scaled.T @ seen + ridge, scaled.T @ wanted)
    return weights.float()
