"""How a detector errs, measured against labels: what the simulated detector is to be like."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import LENGTH, YAW, FloatArray, Z, wrap_angle
from hbbatch.model.kinds import KINDS
from hbbatch.tracking.tracklets import Trajectories

BoolArray = NDArray[np.bool_]

LAGS_S: Final = (0.1, 0.5, 1.0, 2.0)
_NEAR_M: Final = (10.0, 20.0)
_FAR_M: Final = (45.0, 60.0)
_FEWEST_PAIRS: Final = 50
_LARGEST_SHIFT_M: Final = 0.6
_LARGEST_LENGTH_ERROR_M: Final = 1.0


@dataclass(frozen=True)
class DetectorErrors:
    """Errors of the detections of one kind of road user; NaN where there are too few to tell.

    Deviations are 1.48 times the median absolute deviation, which a few gross errors do not move.

    Attributes:
        detections: matched to labels.
        found: share of labelled boxes within 45 m that were detected.
        missed_again: share of misses that follow a miss.
        across_near_m, across_far_m: deviation across the heading at 10 to 20 m and at 45 to 60 m.
        along_near_m, up_near_m, yaw_near_rad: along the heading, upwards, of it, at 10 to 20 m.
        length_near: relative deviation of the length, at 10 to 20 m.
        tails: standard deviation along the heading over the deviation as above, at 10 to 20 m.
        correlation: of errors along the heading, after each of `LAGS_S`.
        backwards: share of headings that point the other way.
        face_shift: how far away from the sensor centres lie, a metre that a box is too long.
    """

    detections: int
    found: float
    missed_again: float
    across_near_m: float
    across_far_m: float
    along_near_m: float
    up_near_m: float
    yaw_near_rad: float
    length_near: float
    tails: float
    correlation: tuple[float, ...]
    backwards: float
    face_shift: float


def detector_errors(of: Trajectories, kind: str) -> DetectorErrors:
    """Errors of the detections of one kind of road user."""
    wanted = np.repeat(of.kind_code == KINDS.index(kind), of.length)
    seen = wanted & of.seen
    offset = of.measured - of.truth
    cos, sin = np.cos(of.truth[:, YAW]), np.sin(of.truth[:, YAW])
    along = offset[:, 0] * cos + offset[:, 1] * sin
    across = offset[:, 1] * cos - offset[:, 0] * sin
    turned = wrap_angle(offset[:, YAW])
    backwards = np.abs(turned) > np.pi / 2
    yaw = wrap_angle(turned + np.pi * backwards)
    range_m = np.hypot(of.sight_m[:, 0], of.sight_m[:, 1])
    near, far = (seen & (low <= range_m) & (range_m < high) for low, high in (_NEAR_M, _FAR_M))
    away = np.sign(of.sight_m[:, 0] * cos + of.sight_m[:, 1] * sin)
    return DetectorErrors(
        detections=int(seen.sum()),
        found=_mean(of.seen[wanted & (range_m < _FAR_M[0])]),
        missed_again=_missed_again(of, wanted),
        across_near_m=_deviation(across[near]),
        across_far_m=_deviation(across[far]),
        along_near_m=_deviation(along[near]),
        up_near_m=_deviation(offset[near, Z]),
        yaw_near_rad=_deviation(yaw[near]),
        length_near=_deviation(offset[near, LENGTH] / of.truth[near, LENGTH]),
        tails=float(along[near].std() / _deviation(along[near])) if near.any() else np.nan,
        correlation=_correlations(of, _tamed(along, seen), seen),
        backwards=_mean(backwards[seen]),
        face_shift=_slope(offset[seen, LENGTH], (along * away)[seen]),
    )


def _mean(values: BoolArray) -> float:
    return float(np.mean(values)) if len(values) else np.nan


def _deviation(values: FloatArray) -> float:
    if len(values) < _FEWEST_PAIRS:
        return np.nan
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def _tamed(error: FloatArray, seen: BoolArray) -> FloatArray:
    """Errors about their median, cut at three deviations, so that a few do not rule."""
    limit = 3.0 * _deviation(error[seen])
    return np.clip(error - np.median(error[seen]) if seen.any() else error, -limit, limit)


def _same_object(of: Trajectories, lag: int) -> BoolArray:
    """Rows whose object is still there so many rows on, `(n - lag,)`."""
    objects = np.repeat(np.arange(len(of.length)), of.length)
    return np.asarray(objects[:-lag] == objects[lag:])


def _missed_again(of: Trajectories, wanted: BoolArray) -> float:
    missed = wanted[:-1] & ~of.seen[:-1] & _same_object(of, 1)
    return _mean(~of.seen[1:][missed])


def _correlations(of: Trajectories, error: FloatArray, seen: BoolArray) -> tuple[float, ...]:
    """Correlation of an object's errors after each lag; datasets may mix frame rates."""
    step_s = np.repeat(_steps_s(of), of.length)
    found = []
    for lag_s in LAGS_S:
        rows = np.round(lag_s / step_s).astype(int)
        firsts, seconds = [], []
        for lag in np.unique(rows[seen & (rows > 0)]):
            pairs = np.flatnonzero(
                seen[:-lag] & seen[lag:] & (rows[:-lag] == lag) & _same_object(of, int(lag))
            )
            firsts.append(error[pairs])
            seconds.append(error[pairs + lag])
        found.append(_correlation(firsts, seconds))
    return tuple(found)


def _steps_s(of: Trajectories) -> FloatArray:
    """Usual time between an object's rows, `(objects,)`; infinite for a single row."""
    last = of.first_row + of.length - 1
    time_s = np.cumsum(of.dt_s)
    steps = (time_s[last] - time_s[of.first_row]) / np.maximum(of.length - 1, 1)
    return np.where(steps > 0, steps, np.inf)


def _correlation(first: list[FloatArray], second: list[FloatArray]) -> float:
    count = sum(map(len, first))
    if count < _FEWEST_PAIRS:
        return np.nan
    return float(np.corrcoef(np.concatenate(first), np.concatenate(second))[0, 1])


def _slope(length_error_m: FloatArray, shift_m: FloatArray) -> float:
    usual = (np.abs(length_error_m) < _LARGEST_LENGTH_ERROR_M) & (
        np.abs(shift_m) < _LARGEST_SHIFT_M
    )
    if usual.sum() < _FEWEST_PAIRS or not length_error_m[usual].any():
        return np.nan
    return float(np.polyfit(length_error_m[usual], shift_m[usual], 1)[0])


def markdown(columns: Mapping[str, DetectorErrors]) -> str:
    """A Markdown table, a column a detector."""
    lines = [f"| | {' | '.join(columns)} |", "|---|" + "---|" * len(columns)]
    for what, values in zip(_ROWS, zip(*map(_cells, columns.values()), strict=True), strict=True):
        lines.append(f"| {what} | {' | '.join(values)} |")
    return "\n".join(lines) + "\n"


_ROWS: Final = (
    "detections",
    "found within 45 m",
    "missed again after a miss",
    "deviation across the heading, 10 to 20 m (m)",
    "the same, 45 to 60 m",
    "along the heading, 10 to 20 m (m)",
    "upwards, 10 to 20 m (m)",
    "of the heading, 10 to 20 m (rad)",
    "of the length, relative, 10 to 20 m",
    "standard deviation along over this deviation",
    *(f"correlation of errors along, {lag_s:g} s later" for lag_s in LAGS_S),
    "headings that point backwards",
    "shift of the centre per error of length",
)


def _cells(errors: DetectorErrors) -> list[str]:
    return [
        f"{errors.detections:,}",
        f"{errors.found:.2f}",
        f"{errors.missed_again:.2f}",
        f"{errors.across_near_m:.3f}",
        f"{errors.across_far_m:.3f}",
        f"{errors.along_near_m:.3f}",
        f"{errors.up_near_m:.3f}",
        f"{errors.yaw_near_rad:.3f}",
        f"{errors.length_near:.3f}",
        f"{errors.tails:.1f}",
        *(f"{value:.2f}" for value in errors.correlation),
        f"{errors.backwards:.3f}",
        f"{errors.face_shift:.2f}",
    ]
