"""Candidate pairs, costs and greedy matching, each against a plain loop."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from hbbatch.config import AssociationSettings
from hbbatch.tracking.association import (
    Pairs,
    Priors,
    associate,
    candidates,
    greedy,
    lay_out,
    matcher,
)
from hbbatch.tracking.costs import COSTS, shapes_of

COST_NAMES = sorted(COSTS)


def boxes_around(rng: np.random.Generator, count: int, spread_m: float = 15.0) -> np.ndarray:
    boxes = np.empty((count, 7))
    boxes[:, :2] = rng.uniform(-spread_m, spread_m, (count, 2))
    boxes[:, 2] = rng.normal(0, 0.3, count)
    boxes[:, 3:6] = rng.uniform([1, 0.5, 1], [6, 2.5, 2], (count, 3))
    boxes[:, 6] = rng.uniform(-np.pi, np.pi, count)
    return boxes


def cost_of(name: str, priors: np.ndarray, detections: np.ndarray) -> np.ndarray:
    return COSTS[name](shapes_of(priors), shapes_of(detections))  # type: ignore[index]


def sequential_greedy(cost: np.ndarray, threshold: float) -> set[tuple[int, int]]:
    """The paper's loop: take the cheapest free pair below the threshold, again and again."""
    cost = cost.copy()
    taken = set()
    while cost.size and cost.min() < threshold:
        track, detection = np.unravel_index(cost.argmin(), cost.shape)
        taken.add((int(track), int(detection)))
        cost[track, :] = cost[:, detection] = np.inf
    return taken


@given(st.data())
def test_greedy_takes_what_the_sequential_algorithm_takes(data: st.DataObject) -> None:
    shape = data.draw(st.tuples(st.integers(1, 8), st.integers(1, 8)))
    cost = data.draw(arrays.arrays(float, shape, elements=st.floats(0, 2), unique=True))
    track, detection = (index.ravel() for index in np.indices(shape))
    order = np.argsort(cost.ravel())
    order = order[cost.ravel()[order] < 1.2]
    found = greedy(Pairs(track[order], detection[order]))
    pairs = set(zip(found.track.tolist(), found.detection.tolist(), strict=True))
    assert pairs == sequential_greedy(cost, 1.2)


@pytest.mark.parametrize("cost", COST_NAMES)
@pytest.mark.parametrize("seed", range(8))
def test_association_equals_the_full_cost_matrix(cost: str, seed: int) -> None:
    """Gating loses no pair that could have been matched, whatever the cost."""
    rng = np.random.default_rng(seed)
    priors, detections = boxes_around(rng, 40), boxes_around(rng, 35)
    settings = AssociationSettings(cost=cost)  # type: ignore[arg-type]
    first, second = (index.ravel() for index in np.indices((40, 35)))
    matrix = cost_of(cost, priors[first], detections[second]).reshape(40, 35)
    block = np.zeros(40, np.int64)
    found = associate(priors, block, detections, block[:35], settings)
    pairs = set(zip(found.track.tolist(), found.detection.tolist(), strict=True))
    assert pairs == sequential_greedy(matrix, settings.threshold)
    assert pairs


@given(st.integers(0, 10_000))
def test_candidates_are_exactly_the_near_pairs_of_equal_block(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tracks, detections = boxes_around(rng, 30), boxes_around(rng, 25)
    track_block, detection_block = rng.integers(0, 4, 30), rng.integers(0, 4, 25)
    reach, other = rng.uniform(1, 5, 30), rng.uniform(1, 5, 25)
    targets = lay_out(detections, detection_block, AssociationSettings())
    targets = targets._replace(reach_m=other[targets.order], widest_m=np.full(25, other.max()))
    track, place = candidates(tracks.T[:2], track_block, reach, targets)
    found = Pairs(track, targets.order[place])
    distance = np.linalg.norm(tracks[:, None, :2] - detections[None, :, :2], axis=2)
    near = (distance < reach[:, None] + other) & (track_block[:, None] == detection_block)
    assert set(zip(*found, strict=True)) == set(zip(*np.nonzero(near), strict=True))


def test_blocks_never_mix_and_do_not_change_each_other() -> None:
    rng = np.random.default_rng(5)
    settings = AssociationSettings()
    priors, detections = boxes_around(rng, 20), boxes_around(rng, 20)
    alone = associate(priors, np.zeros(20, int), detections, np.zeros(20, int), settings)
    block = np.repeat([0, 1], 20)
    both = associate(np.tile(priors, (2, 1)), block, np.tile(detections, (2, 1)), block, settings)
    pairs = set(zip(*alone, strict=True))
    assert set(zip(*both, strict=True)) == pairs | {(t + 20, d + 20) for t, d in pairs}


@pytest.mark.parametrize("cost", COST_NAMES)
def test_batches_laid_out_together_match_as_if_alone(cost: str) -> None:
    """A group's detections are sorted once, and each lock step takes its slice."""
    rng = np.random.default_rng(6)
    settings = AssociationSettings(cost=cost)  # type: ignore[arg-type]
    priors, detections = boxes_around(rng, 30), boxes_around(rng, 60)
    block, batch = rng.integers(0, 2, 60), np.repeat([0, 1], 30)
    matching = matcher(detections, block, settings, batch)
    for start in (0, 30):
        part = slice(start, start + 30)
        found = matching(Priors(priors, block[:30], np.arange(30)), part)
        alone = associate(priors, block[:30], detections[part], block[part], settings)
        there = {(track, detection + start) for track, detection in zip(*alone, strict=True)}
        assert set(zip(*found, strict=True)) == there


def test_a_prior_far_outside_all_detections_reaches_no_other_block() -> None:
    settings = AssociationSettings()
    detections = boxes_around(np.random.default_rng(7), 20)
    block = np.repeat([0, 1], 10)
    lost = detections[:1] + np.array([[1e5, 0, 0, 0, 0, 0, 0]])
    assert len(associate(lost, block[:1], detections, block, settings).track) == 0


@pytest.mark.parametrize("cost", COST_NAMES)
def test_nothing_to_match_is_no_error(cost: str) -> None:
    settings = AssociationSettings(cost=cost)  # type: ignore[arg-type]
    none, one = np.empty((0, 7)), boxes_around(np.random.default_rng(0), 1)
    empty, block = np.empty(0, np.int64), np.zeros(1, np.int64)
    assert len(associate(none, empty, one, block, settings).track) == 0
    assert len(associate(one, block, none, empty, settings).track) == 0


@pytest.mark.parametrize("cost", COST_NAMES)
def test_equal_boxes_cost_nothing_and_distance_costs(cost: str) -> None:
    box = np.array([[3.0, -2.0, 1.0, 4.5, 1.8, 1.5, 0.7]])
    assert cost_of(cost, box, box)[0] == pytest.approx(0.0, abs=1e-6)
    away = box + np.array([[1.0, 0, 0, 0, 0, 0, 0]])
    further = box + np.array([[2.0, 0, 0, 0, 0, 0, 0]])
    assert 0 < cost_of(cost, box, away)[0] < cost_of(cost, box, further)[0]


@given(st.integers(0, 1000), st.floats(-np.pi, np.pi), st.floats(-1e5, 1e5))
def test_ciou_does_not_depend_on_the_axes_of_the_world(seed: int, turn: float, far: float) -> None:
    rng = np.random.default_rng(seed)
    first, second = boxes_around(rng, 5, 3.0), boxes_around(rng, 5, 3.0)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def moved(boxes: np.ndarray) -> np.ndarray:
        boxes = boxes.copy()
        boxes[:, :2] = boxes[:, :2] @ rotation.T + far
        boxes[:, 6] += turn
        return boxes

    for name in ("ciou_3d", "ciou_2d"):
        here = cost_of(name, first, second)
        there = cost_of(name, moved(first), moved(second))
        assert there == pytest.approx(here, abs=1e-6)
