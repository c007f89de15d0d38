"""Smoothers of detections: what they get of made-up objects whose best averages are known."""

from __future__ import annotations

import math

import pytest
import torch

from hbbatch.model.smoothers import (
    CAUSAL,
    SIDE_FRAMES,
    TWO_SIDED,
    dense_windows,
    fit_smoother,
    middle_error,
    smoothed,
)
from hbbatch.model.windows import Windows, WindowSet, window_set

FRAMES = 2 * SIDE_FRAMES + 1
OBJECTS = 400
NOISE_M = 0.1
TOLERANCE_M = 1e-3


def parked(lasting_share: float) -> WindowSet:
    """Parked vehicles, detected with normal errors that last for a share of their variance."""
    generator = torch.Generator().manual_seed(0)
    rows = OBJECTS * FRAMES
    truth = torch.tensor([0.0, 0.0, 0.0, 4.0, 1.8, 1.5, 0.0]).double().repeat(rows, 1)
    truth[:, :2] = 1e4 * torch.rand(OBJECTS, 2, generator=generator).repeat_interleave(FRAMES, 0)
    truth[:, 6] = 6.2 * torch.rand(OBJECTS, generator=generator).repeat_interleave(FRAMES)
    lasting = torch.randn(OBJECTS, 3, generator=generator).repeat_interleave(FRAMES, 0)
    fresh = torch.randn(rows, 3, generator=generator)
    error = math.sqrt(lasting_share) * lasting + math.sqrt(1 - lasting_share) * fresh
    measured = truth.clone()
    measured[:, :3] += NOISE_M * error
    columns = {
        "truth": truth,
        "measured": measured,
        "seen": torch.ones(rows, dtype=torch.bool),
        "sight_m": torch.ones(rows, 3),
        "score": torch.ones(rows),
        "dt_s": torch.full((rows,), 0.1),
    }
    first = torch.arange(0, rows, FRAMES)
    length = torch.full((OBJECTS,), FRAMES)
    return window_set(columns, first, length, torch.zeros(OBJECTS, dtype=torch.long), FRAMES)


def share_left(windows: Windows, frames: tuple[int, ...]) -> float:
    """Error in height after smoothing over that before; fitted and judged on other objects."""
    half = OBJECTS // 2
    known = Windows(*(column[:half] for column in windows))
    judged = Windows(*(column[half:] for column in windows))
    after = middle_error(smoothed(judged, fit_smoother(known, frames)), judged)
    before = middle_error(judged.measured[:, SIDE_FRAMES], judged)
    return after.up_m / before.up_m


@pytest.mark.parametrize("frames", [CAUSAL, TWO_SIDED])
def test_independent_errors_are_averaged_away(frames: tuple[int, ...]) -> None:
    mean = 1 / math.sqrt(len(frames) + 1)
    assert share_left(dense_windows(parked(0.0), 0), frames) == pytest.approx(mean, rel=0.2)


def test_errors_that_last_are_not() -> None:
    windows = dense_windows(parked(0.9), 0)
    bound = math.sqrt(0.9 + 0.1 / FRAMES)
    assert share_left(windows, TWO_SIDED) == pytest.approx(bound, rel=0.05)


def test_only_stretches_of_the_kind_without_a_gap_are_dense() -> None:
    data = parked(0.0)
    data.columns["seen"][: FRAMES // 2] = False
    assert len(dense_windows(data, 0).kind_code) == OBJECTS - 1
    assert not len(dense_windows(data, 1).kind_code)


def test_directions_are_the_objects_own() -> None:
    """Turning an object turns what is smoothed along with it."""
    windows = dense_windows(parked(0.0), 0)
    smoother = fit_smoother(windows, TWO_SIDED)
    turn = torch.tensor(0.7, dtype=torch.float64)
    turned = windows._replace(measured=_turned(windows.measured, turn))
    expected = _turned(smoothed(windows, smoother), turn)
    torch.testing.assert_close(smoothed(turned, smoother), expected, rtol=0, atol=TOLERANCE_M)


def _turned(boxes: torch.Tensor, angle_rad: torch.Tensor) -> torch.Tensor:
    x, y = boxes[..., 0], boxes[..., 1]
    cos, sin = angle_rad.cos(), angle_rad.sin()
    turned = boxes.clone()
    turned[..., 0], turned[..., 1] = cos * x - sin * y, sin * x + cos * y
    turned[..., 6] += angle_rad
    return turned
