"""Both motion filters: what they must do whatever their parameters."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from hbbatch.model.filters import Measurement
from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter
from hbbatch.model.kinds import KINDS

Filter = KalmanFilter | HybridFilter
SENSOR = torch.tensor([-20.0, 5.0, 1.0], dtype=torch.float64)


def randomised(motion: Filter, seed: int = 0) -> Filter:
    """Read-outs start at zero; give the learned parts something to say."""
    generator = torch.Generator().manual_seed(seed)
    for parameter in motion.parameters():
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=generator)
    return motion.eval()


def every_filter() -> list[Filter]:
    classical: list[Filter] = [KalmanFilter(KINDS, model) for model in ("cv", "ca", "ct")]
    return [*classical, randomised(HybridFilter(KINDS))]


FILTERS = pytest.mark.parametrize(
    "motion", every_filter(), ids=lambda m: f"{type(m).__name__}-{getattr(m, 'model', '')}"
)


def seen(boxes: Tensor, sensor: Tensor) -> Measurement:
    return Measurement(boxes, (boxes[:, :3] - sensor).float(), torch.ones(len(boxes)))


def drive(motion: Filter, boxes: Tensor, sensor: Tensor = SENSOR) -> tuple[Tensor, Tensor]:
    """The posterior after each of `(frames, 7)` detections, and the last rows."""
    with torch.inference_mode():
        posterior = boxes[:1]
        rows = motion.birth(seen(posterior, sensor), torch.tensor([0]))
        said = [posterior]
        for box in boxes[1:]:
            prior, rows = motion.predict(posterior, rows, torch.tensor([0.1]))
            posterior, rows = motion.update(prior, rows, seen(box[None], sensor))
            said.append(posterior)
    return torch.cat(said), rows


def straight_drive(frames: int = 25, speed_m_s: float = 10.0, yaw: float = 0.6) -> Tensor:
    distance = torch.arange(frames, dtype=torch.float64) * 0.1 * speed_m_s
    boxes = torch.zeros(frames, 7, dtype=torch.float64)
    boxes[:, 0], boxes[:, 1] = distance * math.cos(yaw), distance * math.sin(yaw)
    boxes[:, 3:6] = torch.tensor([4.5, 1.8, 1.5])
    boxes[:, 6] = yaw
    return boxes


@pytest.mark.parametrize("model", ["cv", "ca", "ct"])
def test_a_steady_drive_is_followed_and_its_velocity_found(model: str) -> None:
    motion = KalmanFilter(KINDS, model)  # type: ignore[arg-type]
    boxes = straight_drive()
    said, rows = drive(motion, boxes)
    assert said[-1] == pytest.approx(boxes[-1], abs=0.05)
    expected = [10 * math.cos(0.6), 10 * math.sin(0.6), 0.0]
    assert motion.velocity(rows)[0].tolist() == pytest.approx(expected, abs=0.3)


@FILTERS
@pytest.mark.parametrize("shift_m", [1e3, 5e6])
def test_where_in_the_world_a_drive_takes_place_does_not_matter(
    motion: Filter, shift_m: float
) -> None:
    boxes = straight_drive()
    away = boxes.clone()
    away[:, :2] += shift_m
    here = drive(motion, boxes)[0]
    there = drive(motion, away, SENSOR + torch.tensor([shift_m, shift_m, 0.0]))[0]
    there[:, :2] -= shift_m
    assert there == pytest.approx(here, abs=1e-4)


@FILTERS
@pytest.mark.parametrize("turn", [1.0, math.pi / 2, 3.0])
def test_which_way_the_world_is_turned_does_not_matter(motion: Filter, turn: float) -> None:
    boxes = straight_drive()
    turned = boxes.clone()
    cos, sin = math.cos(turn), math.sin(turn)
    turned[:, 0] = cos * boxes[:, 0] - sin * boxes[:, 1]
    turned[:, 1] = sin * boxes[:, 0] + cos * boxes[:, 1]
    turned[:, 6] += turn
    sensor = torch.tensor([cos * -20 - sin * 5, sin * -20 + cos * 5, 1.0], dtype=torch.float64)
    here, there = drive(motion, boxes)[0], drive(motion, turned, sensor)[0]
    x = cos * here[:, 0] - sin * here[:, 1]
    y = sin * here[:, 0] + cos * here[:, 1]
    assert torch.stack([x, y], 1) == pytest.approx(there[:, :2], abs=1e-4)
    assert torch.cos(here[:, 6] + turn - there[:, 6]) == pytest.approx(1.0, abs=1e-6)


@FILTERS
def test_a_heading_flipped_by_half_a_turn_does_not_turn_a_track(motion: Filter) -> None:
    boxes = straight_drive()
    flipped = boxes.clone()
    flipped[[7, 12, 18], 6] += math.pi
    assert drive(motion, flipped)[0] == pytest.approx(drive(motion, boxes)[0], abs=1e-5)


def test_a_track_born_the_wrong_way_round_is_turned_once_outvoted() -> None:
    boxes = straight_drive()
    boxes[0, 6] += math.pi
    said, _ = drive(KalmanFilter(KINDS), boxes)
    assert math.cos(said[-1, 6].item() - 0.6) == pytest.approx(1.0, abs=1e-3)


@FILTERS
def test_yaw_stays_wrapped_across_the_seam(motion: Filter) -> None:
    boxes = straight_drive(yaw=math.pi)
    boxes[::2, 6] = math.pi - 0.02
    boxes[1::2, 6] = -math.pi + 0.02
    said, _ = drive(motion, boxes)
    assert (said[:, 6].abs() > math.pi - 0.3).all()
    assert (said[1:, 6] < math.pi).all()


@FILTERS
def test_a_track_does_not_feel_the_others_of_its_batch(motion: Filter) -> None:
    boxes = torch.cat([straight_drive(3), straight_drive(3, 3.0, 2.0)])
    code = torch.tensor([0, 0, 0, 1, 1, 1])
    with torch.inference_mode():
        rows = motion.birth(seen(boxes, SENSOR), code)
        together = motion.predict(boxes, rows, torch.full((6,), 0.1))
        alone = [
            motion.predict(boxes[i : i + 1], rows[i : i + 1], torch.tensor([0.1])) for i in range(6)
        ]
    assert torch.cat([a for a, _ in alone]) == pytest.approx(together[0], abs=1e-6)
    assert torch.cat([b for _, b in alone]) == pytest.approx(together[1], abs=1e-4)


def test_an_untrained_hybrid_filter_is_its_classical_base() -> None:
    torch.manual_seed(0)
    hybrid = HybridFilter(KINDS)
    boxes = straight_drive() + 0.05 * torch.randn(25, 7, dtype=torch.float64)
    assert drive(hybrid, boxes)[0] == pytest.approx(drive(hybrid.base, boxes)[0], abs=1e-6)


def test_the_learned_residual_leaves_height_and_sizes_to_the_base() -> None:
    learned = randomised(HybridFilter(KINDS))
    assert isinstance(learned, HybridFilter)
    box = torch.tensor([[10.0, 5.0, 1.0, 4.0, 1.8, 1.5, 0.3]], dtype=torch.float64)
    rows = learned.birth(seen(box, SENSOR), torch.tensor([0]))
    with torch.inference_mode():
        prior, _ = learned.predict(box, rows, torch.tensor([0.1]))
        moved, _ = learned.base.predict(box, rows[:, learned.columns["base"]], torch.tensor([0.1]))
    assert (prior != moved).flatten().tolist() == [True, True, *4 * [False], True]


def test_uncertain_measurements_move_a_track_less() -> None:
    motion = KalmanFilter(KINDS)
    boxes = straight_drive(6)
    boxes[-1, 0] += 1.0
    trusting = drive(motion, boxes)[0][-1, 0].item()
    motion.log_r.data += 3.0
    assert drive(motion, boxes)[0][-1, 0].item() < trusting
