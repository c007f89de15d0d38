"""Calibration: a filter with the right noise is called calibrated, and no other."""

from __future__ import annotations

import pytest
import torch

from hbbatch.model.calibration import AXIS_NAMES, Calibration, calibration
from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter
from hbbatch.model.kinds import KINDS
from hbbatch.model.windows import Windows
from tests.model.moving import simulated

NOISE_M = 0.1


def windows() -> Windows:
    """Vehicles at a constant speed, measured with white noise."""
    data = simulated(objects=120, noise_m=NOISE_M)
    chosen = torch.nonzero(data.frames_left >= 30).flatten()
    return data.cut(chosen, 30)


def told_the_noise(motion: KalmanFilter, factor: float = 1.0) -> KalmanFilter:
    """The same filter, with measurement noise as it is, in variances times `factor`."""
    deviation = torch.tensor([NOISE_M, NOISE_M, 0.05, 0.02])
    with torch.no_grad():
        motion.log_r.copy_((deviation**2 * factor).log().expand_as(motion.log_r))
        motion.log_q.fill_(-12.0)
        motion.log_initial[:, 0, :2] = 3.5
    return motion


def along(lines: list[Calibration], checked: str) -> Calibration:
    return next(line for line in lines if (line.checked, line.axis) == (checked, "along"))


def test_the_right_noise_is_calibrated() -> None:
    lines = calibration(told_the_noise(KalmanFilter(KINDS)), windows())
    assert [line.axis for line in lines] == [*AXIS_NAMES, *AXIS_NAMES]
    for line in lines:
        assert line.count > 2000
        assert line.within == pytest.approx((0.5, 0.9, 0.99), abs=0.05), line
        assert line.mean_square == pytest.approx(1.0, abs=0.15), line


def test_noise_told_too_small_shows_as_too_much_confidence() -> None:
    line = along(calibration(told_the_noise(KalmanFilter(KINDS), 0.25), windows()), "innovation")
    assert line.mean_square == pytest.approx(4.0, rel=0.2)
    assert line.within[1] < 0.7


def test_an_untrained_learned_filter_is_as_calibrated_as_its_base() -> None:
    torch.manual_seed(0)
    learned = HybridFilter(KINDS)
    base = told_the_noise(learned.base)
    expected, found = calibration(base, windows()), calibration(learned, windows())
    for one, other in zip(expected, found, strict=True):
        assert other.mean_square == pytest.approx(one.mean_square, rel=1e-3)
