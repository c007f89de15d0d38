"""How far a filter is off: predictions some frames ahead, and posteriors, by age of the track."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from hbbatch.model.filters import MotionFilter
from hbbatch.model.losses import box_error
from hbbatch.model.windows import Windows

AGES = (3, 10, 18)
"""Frames since birth at which a filter is judged."""

HORIZONS = (1, 5, 10)
"""Frames ahead that are predicted without seeing a detection."""


@dataclass(frozen=True)
class FilterError:
    """Mean errors in the heading frame of the truth.

    Attributes:
        age: frames since the track's birth.
        frames_ahead: 0 for the posterior.
        count: boxes judged.
        plan_m: distance of centres seen from above.
        along_m, across_m, up_m: absolute errors of the centre.
        yaw_rad: modulo a half turn.
        size_m: mean of the three absolute size errors.
    """

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
def filter_errors(motion: MotionFilter, windows: Windows) -> list[FilterError]:
    """Errors at every age of `AGES`: the posterior and each horizon of `HORIZONS`.

    Args:
        motion: the filter.
        windows: at least `max(AGES) + max(HORIZONS)` frames long.
    """
    boxes = windows.measured[:, 0]
    rows = motion.birth(windows.measurement(0), windows.kind_code)
    errors = []
    for frame in range(1, max(AGES) + 1):
        if frame in AGES:
            errors += _ahead(motion, windows, boxes, rows, frame)
        prior, predicted = motion.predict(boxes, rows, windows.dt_s[:, frame])
        corrected, updated = motion.update(prior, predicted, windows.measurement(frame))
        seen = windows.seen[:, frame, None]
        boxes = torch.where(seen, corrected, prior)
        rows = torch.where(seen, updated, predicted)
        if frame in AGES:
            errors.append(_error(boxes, windows, frame, windows.seen[:, frame], frame, 0))
    return errors


def _ahead(
    motion: MotionFilter, windows: Windows, boxes: Tensor, rows: Tensor, first: int
) -> list[FilterError]:
    errors = []
    for ahead in range(1, max(HORIZONS) + 1):
        frame = first + ahead - 1
        boxes, rows = motion.predict(boxes, rows, windows.dt_s[:, frame])
        if ahead in HORIZONS:
            errors.append(_error(boxes, windows, frame, windows.valid[:, frame], first, ahead))
    return errors


def _error(
    boxes: Tensor, windows: Windows, frame: int, judged: Tensor, age: int, ahead: int
) -> FilterError:
    error = box_error(boxes, windows.truth[:, frame])[judged]
    mean = error.mean(dim=0).tolist()
    return FilterError(
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
