"""The packed filters against the torch modules they are made from.

Both compute in float32 but round in another order; 2e-4 of a metre, metre per second or unit of
memory is what remains after a few steps.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from hbbatch.model.filters import Measurement
from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter, MotionModel
from hbbatch.motion.constants import SMALLEST_SIZE_M
from hbbatch.packed.arrays import PACKED
from tests.model.twins import packed

KINDS = ("vehicle", "pedestrian", "cyclist")
TOLERANCE = 2e-4
TRACKS = 150
"""More than two of the blocks that the kernels work on."""

pytestmark = pytest.mark.usefixtures("kernels")


def shaken(motion: nn.Module) -> nn.Module:
    """Parameters moved at random, so that no part of the network is silent."""
    torch.manual_seed(3)
    with torch.no_grad():
        for parameter in motion.parameters():
            parameter.add_(0.15 * torch.randn_like(parameter))
    return motion.eval()


def detections(
    rng: np.random.Generator, near: np.ndarray | None = None, smallest_m: float = 0.5
) -> Measurement:
    boxes = rng.normal(0, 0.4, (TRACKS, 7))
    if near is None:
        boxes[:, :2] = rng.uniform(-1e5, 1e5, (TRACKS, 2))
        boxes[:, 3:6] = smallest_m * rng.uniform([1, 1, 2], [12, 5, 4], (TRACKS, 3))
        boxes[:, 6] = rng.uniform(-np.pi, np.pi, TRACKS)
    else:
        boxes += near
        boxes[:, 3:6] = np.maximum(boxes[:, 3:6], 0.2 * smallest_m)
        boxes[:, 6] += np.pi * rng.integers(0, 2, TRACKS)
    sight = rng.uniform(-40, 40, (TRACKS, 3))
    return Measurement(
        torch.from_numpy(boxes), torch.from_numpy(sight).float(), torch.zeros(TRACKS)
    )


@pytest.mark.parametrize("model", ["cv", "ca", "ct"])
@pytest.mark.parametrize("make", [KalmanFilter, HybridFilter])
def test_a_packed_filter_steps_like_its_module(make: type[nn.Module], model: MotionModel) -> None:
    assert step_both(made(make, model), smallest_m=0.5) > SMALLEST_SIZE_M


def test_so_it_does_where_only_the_prediction_was_learned() -> None:
    motion = _without_a_say_in_the_gain(made(HybridFilter, "cv"))
    assert step_both(motion, smallest_m=0.5) > SMALLEST_SIZE_M


@pytest.mark.parametrize("make", [KalmanFilter, HybridFilter])
def test_so_it_does_where_no_box_may_get_smaller(make: type[nn.Module]) -> None:
    assert step_both(made(make, "ct"), smallest_m=0.06) == pytest.approx(SMALLEST_SIZE_M, abs=1e-6)


@torch.inference_mode()
def test_kinds_that_are_not_learned_move_like_the_classical_base() -> None:
    rng = np.random.default_rng(1)
    motion = shaken(HybridFilter(KINDS, "ct", learned=(True, False, True)))
    assert isinstance(motion, HybridFilter)
    seen, pedestrians = detections(rng), torch.ones(TRACKS, dtype=torch.long)
    boxes, rows = seen.boxes, motion.birth(seen, pedestrians)
    plain_boxes, plain_rows = boxes, motion.base.birth(seen, pedestrians)
    dt = torch.full((TRACKS,), 0.1)
    for _ in range(4):
        boxes, rows = motion.predict(boxes, rows, dt)
        plain_boxes, plain_rows = motion.base.predict(plain_boxes, plain_rows, dt)
        seen = detections(rng, plain_boxes.numpy())
        boxes, rows = motion.update(boxes, rows, seen)
        plain_boxes, plain_rows = motion.base.update(plain_boxes, plain_rows, seen)
    torch.testing.assert_close(boxes, plain_boxes, rtol=0, atol=1e-6)


def test_a_list_of_learned_kinds_of_another_length_is_refused() -> None:
    with pytest.raises(TypeError, match="learned has 1 entries for 3 kinds"):
        HybridFilter(KINDS, "ct", learned=(True,))


def made(make: type[nn.Module], model: MotionModel) -> nn.Module:
    learned = {"learned": (True, False, True)} if make is HybridFilter else {}
    return shaken(make(KINDS, model, **learned))


def _without_a_say_in_the_gain(motion: nn.Module) -> nn.Module:
    assert isinstance(motion, HybridFilter)
    with torch.no_grad():
        for parameter in motion.gain.read_out.parameters():
            parameter.zero_()
    return motion


@torch.inference_mode()
def step_both(motion: nn.Module, smallest_m: float) -> float:
    """Step a module and its twin side by side; the smallest size any box had."""
    rng = np.random.default_rng(0)
    twin = packed(motion)  # type: ignore[arg-type]
    kinds = rng.integers(0, 3, TRACKS)
    seen = detections(rng, smallest_m=smallest_m)
    smallest = np.inf
    boxes, rows = seen.boxes, motion.birth(seen, torch.from_numpy(kinds))
    columns, frames = np.arange(TRACKS), np.arange(TRACKS)
    packed_boxes = np.full((7, TRACKS + 3), np.nan)
    state = np.full((twin.height, TRACKS + 5), np.nan, np.float32)
    features = twin.detections(seen.sight_m.numpy(), kinds)
    measured = np.ascontiguousarray(seen.boxes.numpy())
    twin.birth(packed_boxes, state, measured, features, columns, kinds, 0)
    for step in range(6):
        dt = rng.uniform(0.05, 0.3, TRACKS).astype(np.float32)
        boxes, rows = motion.predict(boxes, rows, torch.from_numpy(dt))
        prior = twin.predict(packed_boxes, state, twin.times(dt), frames, None)
        assert_same(boxes, prior)
        if step == 3:  # a step without detections
            continue
        seen = detections(rng, boxes.numpy(), smallest_m)
        boxes, rows = motion.update(boxes, rows, seen)
        features = twin.detections(seen.sight_m.numpy(), kinds)
        order = rng.permutation(TRACKS)  # where detections lie does not matter
        places = order.argsort()
        measured = seen.boxes.numpy()[order]
        twin.update(packed_boxes, state, measured, features[order], places)
        assert_same(boxes, packed_boxes[PACKED, :TRACKS])
        velocity = motion.velocity(rows).numpy().T
        found = state[twin.velocity : twin.velocity + 3, :TRACKS]
        assert found == pytest.approx(velocity, abs=TOLERANCE, rel=TOLERANCE)
        smallest = min(smallest, float(boxes[:, 3:6].min()))
    assert np.isnan(packed_boxes[:, TRACKS:]).all()
    assert np.isnan(state[:, TRACKS:]).all()
    return smallest


def assert_same(boxes: torch.Tensor, fields: np.ndarray) -> None:
    difference = boxes.numpy() - fields.T
    difference[:, 6] = np.sin(difference[:, 6] / 2)
    assert np.abs(difference).max() < TOLERANCE
