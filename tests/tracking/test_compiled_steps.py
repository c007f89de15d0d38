"""The compiled steps against those of the torch modules, over whole drives and all settings.

Both compute in float32 but round in another order. With the shipped weights a tenth of a millimetre
is what remains; with parameters at random, 2e-4 of a metre or metre per second after a few steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from hbbatch.config import TrackSettings
from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter
from hbbatch.model.weights_files import open_weights
from hbbatch.motion.columns import MotionModel
from hbbatch.motion.constants import SMALLEST_SIZE_M
from hbbatch.tracking.compiled_steps import CompiledSteps, compiled_steps
from hbbatch.tracking.eager_steps import EagerSteps, eager_steps
from hbbatch.tracking.frames import SequenceFrames
from hbbatch.tracking.lockstep import LockStep
from hbbatch.tracking.schedule import schedule
from hbbatch.tracking.tensor_bank import TensorBank
from hbbatch.tracking.tracks import SequenceTracks
from tests.packed.twins import packed
from tests.tracking.drives import passing_cars, sequence

ONLINE = {"protocol": "online", "max_coasted": 10}
SETTINGS = {
    "default": {},
    "coasting": {"output": ONLINE},
    "damped": {"output": ONLINE, "damping": {"enabled": True}},
    "patient": {"management": {"max_misses": 40, "max_misses_unconfirmed": 20}},
    "damped, patient with the unconfirmed": {
        "output": ONLINE,
        "damping": {"enabled": True},
        "management": {"max_misses": 3, "max_misses_unconfirmed": 8},
    },
    "far": {"association": {"cost": "l2"}},
}

pytestmark = pytest.mark.usefixtures("kernels")


def tracks(
    group: Sequence[SequenceFrames], settings: TrackSettings, compiled: bool
) -> dict[int, SequenceTracks]:
    file = open_weights(settings.filter, settings.weights, settings.classes)
    kinds, plan = np.array(file.kind_codes), schedule(group)
    make = compiled_steps(file) if compiled else eager_steps(file, "cpu")
    steps = make(plan, kinds[plan.class_codes], settings)
    return {n: found for n, found, _ in LockStep(plan, steps).run()}


def assert_same(group: Sequence[SequenceFrames], settings: TrackSettings) -> None:
    fast, slow = (tracks(group, settings, compiled) for compiled in (True, False))
    assert fast.keys() == slow.keys()
    for number, found in fast.items():
        expected = slow[number]
        for name in ("frame_index", "track_id", "class_code", "state", "detection_row"):
            assert getattr(found, name).tolist() == getattr(expected, name).tolist()
        assert found.score == pytest.approx(expected.score, nan_ok=True, abs=0)
        apart = found.boxes - expected.boxes
        apart[:, 6] = np.sin(apart[:, 6] / 2)
        assert np.abs(apart).max(initial=0.0) < 1e-4
        assert found.velocity_m_s == pytest.approx(expected.velocity_m_s, abs=1e-2)


@pytest.mark.parametrize("name", ["kalman", "hybrid"])
@pytest.mark.parametrize("changes", SETTINGS.values(), ids=SETTINGS)
def test_both_track_alike(name: str, changes: dict[str, object]) -> None:
    group = [passing_cars(seed, 40 + 10 * seed, cars=6 + seed) for seed in range(5)]
    assert_same(group, TrackSettings.model_validate({"filter": name, **changes}))


@pytest.mark.parametrize("name", ["kalman", "hybrid"])
@pytest.mark.parametrize("cost", ["ciou_3d", "l2"])
def test_so_they_do_for_long_and_where_boxes_are_there_twice(name: str, cost: str) -> None:
    """More steps than are done at once, and tracks that compete although they are the same."""
    group = [passing_cars(seed, 80 * seed, 6 + seed, doubled=0.2) for seed in range(5)]
    settings = {"filter": name, "association": {"cost": cost}, "output": {"protocol": "gap_filled"}}
    assert_same(group, TrackSettings.model_validate(settings))


@pytest.mark.parametrize("name", ["kalman", "hybrid"])
def test_and_so_they_do_on_real_drives(test_data: Path, name: str) -> None:
    from tests.tracking.real_drives import real_frames

    group = [real_frames(test_data, s) for s in ("0000", "0003", "0012", "0014")]
    assert_same(group, TrackSettings.model_validate({"filter": name}))


KINDS = ("vehicle", "pedestrian", "cyclist")
TRACKS = 150
"""More than two of the blocks that the kernels work on."""

ONE_EACH = TrackSettings.model_validate(
    {"association": {"cost": "l2", "max_cost": 1e6}, "output": ONLINE}
)
"""Where every track is alone in its sequence, it is matched by whatever is detected."""


def shaken(make: type[nn.Module], model: MotionModel) -> nn.Module:
    """A filter with parameters moved at random, so that no part of the network is silent."""
    motion = make(
        KINDS, model, **({"learned": (True, False, True)} if make is HybridFilter else {})
    )
    torch.manual_seed(3)
    with torch.no_grad():
        for parameter in motion.parameters():
            parameter.add_(0.15 * torch.randn_like(parameter))
    return motion.eval()


def wanderers(smallest_m: float) -> list[SequenceFrames]:
    """Sequences of one object each, which turns by half now and then and is not seen once."""
    rng = np.random.default_rng(0)
    group = []
    for number in range(TRACKS):
        box = np.zeros(7)
        box[:2] = rng.uniform(-1e5, 1e5, 2)
        box[3:6] = smallest_m * rng.uniform([1, 1, 2], [12, 5, 4])
        box[6] = rng.uniform(-np.pi, np.pi)
        frames: list[list[list[float]]] = []
        for frame in range(7):
            frames.append([] if frame == 4 else [box.tolist()])
            box = box + rng.normal(0, 0.4, 7)
            box[3:6] = np.maximum(box[3:6], 0.2 * smallest_m)
            box[6] += np.pi * rng.integers(0, 2)
        codes = [[number % 3] * len(boxes) for boxes in frames]
        group.append(
            sequence(frames, codes=codes, name=str(number), dt_s=float(rng.uniform(0.05, 0.3)))
        )
    return group


def step_both(motion: nn.Module, smallest_m: float) -> float:
    """Step a filter at random either way; the smallest size any box had."""
    group = wanderers(smallest_m)
    plan = schedule(group)
    bank = TensorBank(motion, plan, plan.class_codes, torch.device("cpu"))
    slow = LockStep(plan, EagerSteps(bank, plan, plan.class_codes, ONE_EACH))
    fast = LockStep(plan, CompiledSteps(packed(motion), plan, plan.class_codes, ONE_EACH))
    smallest = np.inf
    for (number, expected, _), (same, found, _) in zip(slow.run(), fast.run(), strict=True):
        assert number == same
        assert found.track_id.tolist() == expected.track_id.tolist() == [1] * 7
        assert found.state.tolist() == expected.state.tolist() == [0, 0, 0, 0, 1, 0, 0]
        apart = found.boxes - expected.boxes
        apart[:, 6] = np.sin(apart[:, 6] / 2)
        assert np.abs(apart).max() < 2e-4
        assert found.velocity_m_s == pytest.approx(expected.velocity_m_s, abs=2e-4, rel=2e-4)
        smallest = min(smallest, float(found.boxes[:, 3:6].min()))
    return smallest


@pytest.mark.parametrize("model", ["cv", "ca", "ct"])
@pytest.mark.parametrize("make", [KalmanFilter, HybridFilter])
def test_a_filter_of_any_parameters_steps_alike(make: type[nn.Module], model: MotionModel) -> None:
    assert step_both(shaken(make, model), smallest_m=0.5) > SMALLEST_SIZE_M


def test_so_it_does_where_only_the_prediction_was_learned() -> None:
    motion = shaken(HybridFilter, "cv")
    assert isinstance(motion, HybridFilter)
    for parameter in motion.gain.read_out.parameters():
        nn.init.zeros_(parameter)
    assert step_both(motion, smallest_m=0.5) > SMALLEST_SIZE_M


@pytest.mark.parametrize("make", [KalmanFilter, HybridFilter])
def test_so_it_does_where_no_box_may_get_smaller(make: type[nn.Module]) -> None:
    smallest = step_both(shaken(make, "ct"), smallest_m=0.06)
    assert smallest == pytest.approx(SMALLEST_SIZE_M, abs=1e-6)
