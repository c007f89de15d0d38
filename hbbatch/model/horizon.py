"""How far a filter is off: predictions some frames ahead, and posteriors, by age of the track."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from hbbatch.model.filters import MotionFilter
from hbbatch.model.losses import box_error
from hbbatch.model.windows import Windows


@dataclass(frozen=True)
class Asked:
    """When a filter is judged.

    Attributes:
        stride: every how manieth frame it is given, as if the sensor were slower.
        ages: kept frames since birth at which it is judged.
        horizons: kept frames ahead that are predicted without seeing a detection.
    """

    stride: int
    ages: tuple[int, ...]
    horizons: tuple[int, ...]

    @property
    def frames(self) -> int:
        """Kept frames that are needed."""
        return max(self.ages) + max(self.horizons)

    @property
    def rows(self) -> int:
        """Frames that an object must last, those not kept included."""
        return (self.frames - 1) * self.stride + 1


EVERY_FRAME: Final = Asked(1, (3, 10, 18), (1, 5, 10))
SLOWER: Final = (Asked(2, (10,), (1, 5)), Asked(5, (10,), (1, 5)))
"""At 10 Hz: 5 and 2 Hz."""


@dataclass(frozen=True)
class FilterError:
    """Mean errors in the heading frame of the truth.

    Attributes:
        stride: every how manieth frame the filter was given.
        age: kept frames since the track's birth.
        frames_ahead: kept frames ahead, 0 for the posterior.
        count: boxes judged.
        plan_m: distance of centres seen from above.
        along_m, across_m, up_m: absolute errors of the centre.
        yaw_rad: modulo a half turn.
        size_m: mean of the three absolute size errors.
    """

    stride: int
    age: int
    frames_ahead: int
    count: int
    plan_m: float
    along_m: float
    across_m: float
    up_m: float
    yaw_rad: float
    size_m: float


@torch.inference_mode()
def filter_errors(
    motion: MotionFilter, windows: Windows, asked: Asked = EVERY_FRAME
) -> list[FilterError]:
    """Errors at every age asked for: each horizon and the posterior.

    Args:
        motion: the filter.
        windows: at least `asked.frames` frames long, cut with its stride.
        asked: when it is judged.
    """
    boxes = windows.measured[:, 0]
    rows = motion.birth(windows.measurement(0), windows.kind_code)
    errors = []
    for frame in range(1, max(asked.ages) + 1):
        if frame in asked.ages:
            errors += _ahead(motion, windows, boxes, rows, frame, asked)
        prior, predicted = motion.predict(boxes, rows, windows.dt_s[:, frame])
        corrected, updated = motion.update(prior, predicted, windows.measurement(frame))
        seen = windows.seen[:, frame, None]
        boxes = torch.where(seen, corrected, prior)
        rows = torch.where(seen, updated, predicted)
        if frame in asked.ages:
            found = windows.seen[:, frame]
            errors.append(mean_error(boxes, windows, frame, found, (asked.stride, frame, 0)))
    return errors


def _ahead(
    motion: MotionFilter, windows: Windows, boxes: Tensor, rows: Tensor, first: int, asked: Asked
) -> list[FilterError]:
    errors = []
    for ahead in range(1, max(asked.horizons) + 1):
        frame = first + ahead - 1
        boxes, rows = motion.predict(boxes, rows, windows.dt_s[:, frame])
        if ahead in asked.horizons:
            there = windows.valid[:, frame]
            errors.append(mean_error(boxes, windows, frame, there, (asked.stride, first, ahead)))
    return errors


def mean_error(
    boxes: Tensor, windows: Windows, frame: int, judged: Tensor, when: tuple[int, int, int]
) -> FilterError:
    """Mean errors of boxes `(b, 7)` against the truth of one frame of the windows.

    Args:
        boxes: to be judged.
        windows: with their truth.
        frame: of the windows.
        judged: `(b,)` bool, which boxes count.
        when: stride, age and frames ahead that the boxes are for.
    """
    error = box_error(boxes, windows.truth[:, frame])[judged]
    mean = error.mean(dim=0).tolist()
    stride, age, ahead = when
    return FilterError(
        stride=stride,
        age=age,
        frames_ahead=ahead,
        count=len(error),
        plan_m=error[:, :2].norm(dim=1).mean().item(),
        along_m=mean[0],
        across_m=mean[1],
        up_m=mean[2],
        yaw_rad=mean[3],
        size_m=sum(mean[4:]) / 3,
    )
