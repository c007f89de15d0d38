"""The lock step against the plain loop it stands for."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hbbatch.config import TrackSettings
from hbbatch.model.weights import load_filter
from hbbatch.tracking.compiled_steps import CompiledSteps
from hbbatch.tracking.eager_steps import EagerSteps
from hbbatch.tracking.lockstep import LockStep
from hbbatch.tracking.plain import track_plainly
from hbbatch.tracking.schedule import schedule
from hbbatch.tracking.steps import Steps
from hbbatch.tracking.tensor_bank import TensorBank
from hbbatch.tracking.tracks import SequenceTracks
from tests.packed.twins import packed
from tests.tracking.drives import passing_cars

BOX_TOLERANCE = 1e-3
"""Metres and radians: the packed filters round in another order."""


@pytest.mark.parametrize("name", ["kalman", "hybrid"])
@pytest.mark.parametrize("way", ["eager", "compiled"])
@torch.inference_mode()
def test_lock_step_says_what_the_plain_loop_says(
    name: str, way: str, request: pytest.FixtureRequest
) -> None:
    loaded = load_filter(name, None, ["car"])
    settings = TrackSettings.model_validate({"filter": name})
    kinds = np.array(loaded.kind_codes)
    motion = loaded.motion.eval()
    group = [passing_cars(seed, name=str(seed)) for seed in range(3)]
    plan = schedule(group)
    codes = kinds[plan.class_codes]
    bank = TensorBank(motion, plan, codes, torch.device("cpu"))
    steps: Steps = EagerSteps(bank, plan, codes, settings)
    if way == "compiled":
        request.getfixturevalue("kernels")
        steps = CompiledSteps(packed(motion), plan, codes, settings)
    for number, tracks, _ in LockStep(plan, steps).run():
        plain = track_plainly(group[number], motion, kinds, settings)
        assert by_track(tracks).keys() == {i + 1 for i in range(len(plain))}
        for track_id, boxes in by_track(tracks).items():
            expected = plain[track_id - 1]
            assert boxes.keys() == expected.keys()
            difference = np.array([boxes[frame] - expected[frame] for frame in boxes])
            difference[:, 6] = np.sin(difference[:, 6])
            assert np.abs(difference).max() < BOX_TOLERANCE


def by_track(tracks: SequenceTracks) -> dict[int, dict[int, np.ndarray]]:
    found: dict[int, dict[int, np.ndarray]] = {}
    for track, frame, box in zip(tracks.track_id, tracks.frame_index, tracks.boxes, strict=True):
        found.setdefault(int(track), {})[int(frame)] = box
    return found
