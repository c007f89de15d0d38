"""Whether a filter's covariance is right: how often errors lie where it says they should.

Innovations are held against the variance that the filter expected of them, posterior errors against
the posterior variance. Of a calibrated filter the squares of both, over their variances, are 1 in
the mean, and a share q of them lies within the central interval of probability q (Bar-Shalom, Li
and Kirubarajan 2001, section 5.4).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final, Literal, NamedTuple

import torch
from torch import Tensor

from hbbatch.model.filters import innovation
from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter
from hbbatch.model.unroll import Step, unroll
from hbbatch.model.windows import Windows
from hbbatch.motion.constants import AXES

PROBABILITIES: Final = (0.5, 0.9, 0.99)
"""Of the central intervals that are counted."""

AXIS_NAMES: Final = ("along", "across", "up", "yaw")

_OUTLIER: Final = 25.0
"""Normalised squares are cut here (five standard deviations) for the mean, so that a few wrongly
matched detections do not hide what the rest says."""

BURN_IN_FRAMES: Final = 3
"""Frames after birth that are not judged: velocities are still being found."""

CovarianceFilter = KalmanFilter | HybridFilter
"""Filters whose rows carry a covariance."""

Checked = Literal["innovation", "posterior"]


@dataclass(frozen=True)
class Calibration:
    """How one axis of a filter fits its variance.

    Attributes:
        checked: "innovation" (detection minus prior) or "posterior" (posterior minus truth).
        axis: one of `AXIS_NAMES`.
        count: errors judged.
        mean_square: of errors over their standard deviation, cut at 25; 0.98 to 1 when calibrated.
        within: share of errors within the central interval of each of `PROBABILITIES`.
    """

    checked: Checked
    axis: str
    count: int
    mean_square: float
    within: tuple[float, ...]


class _Errors(NamedTuple):
    """Errors and their variances, `(b, 4)` each, and which rows count `(b,)`."""

    error: Tensor
    variance: Tensor
    counted: Tensor


@torch.inference_mode()
def calibration(motion: CovarianceFilter, windows: Windows) -> list[Calibration]:
    """Innovations and posterior errors held against the filter's own covariance, axis by axis.

    Args:
        motion: the filter.
        windows: at least five frames long.
    """
    seen: dict[Checked, list[_Errors]] = {"innovation": [], "posterior": []}
    for step in unroll(motion, windows):
        if step.frame > BURN_IN_FRAMES:
            for checked, errors in _judged(motion, windows, step):
                seen[checked].append(errors)
    return [line for checked, errors in seen.items() for line in _summary(checked, errors)]


def _judged(
    motion: CovarianceFilter, windows: Windows, step: Step
) -> Iterator[tuple[Checked, _Errors]]:
    prior, posterior = variances(motion, step.predicted), variances(motion, step.rows)
    seen = windows.seen[:, step.frame]
    # The gain tells what was expected: P⁺ = P - P²/S.
    expected = prior.square() / (prior - posterior)
    surprise = innovation(step.prior, windows.measured[:, step.frame]).motion
    yield "innovation", _Errors(surprise, expected, seen)
    error = innovation(windows.truth[:, step.frame], step.posterior).motion
    yield "posterior", _Errors(error, posterior, seen)


def variances(motion: CovarianceFilter, rows: Tensor) -> Tensor:
    """Variance of along, across, up and yaw `(n, 4)` that a filter's rows carry."""
    base, own = motion, rows
    if isinstance(motion, HybridFilter):
        base, own = motion.base, rows[:, motion.columns["base"]]
    return own[:, base.columns["covariance"]][:, :AXES]


def _summary(checked: Checked, parts: list[_Errors]) -> Iterator[Calibration]:
    error, variance, counted = (torch.cat(column) for column in zip(*parts, strict=True))
    squares = (error.square() / variance)[counted].double()
    limits = [NormalDist().inv_cdf(0.5 + p / 2) ** 2 for p in PROBABILITIES]
    for axis, name in enumerate(AXIS_NAMES):
        of_axis = squares[:, axis]
        yield Calibration(
            checked=checked,
            axis=name,
            count=len(of_axis),
            mean_square=of_axis.clamp(max=_OUTLIER).mean().item(),
            within=tuple((of_axis <= limit).double().mean().item() for limit in limits),
        )
