"""The compiled matching against the one in numpy, and what it refuses."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hbbatch.config import AssociationSettings
from hbbatch.tracking.association import Priors, compiled_matcher, lay_out, match
from tests.tracking.test_association import boxes_around, cost_of

pytestmark = pytest.mark.usefixtures("kernels")

MOST_COST = 1.8
"""How far boxes can be matched is known for thresholds below this only."""

PAIR_TOLERANCE = 1e-9
"""Costs this near may be taken in either order: sines are rounded in different ways."""


def assert_same_pairs(
    priors: np.ndarray,
    track_block: np.ndarray,
    detections: np.ndarray,
    detection_block: np.ndarray,
    threshold: float = 1.3,
    start: int = 0,
) -> int:
    """Both match alike, or pairs that cost the same; how many pairs there are."""
    settings = AssociationSettings(cost="ciou_3d", max_cost=threshold)
    batch = np.repeat([0, 1], [start, len(detections) - start])
    targets = lay_out(detections, detection_block, settings, batch)
    part = slice(start, len(detections))
    tracks = Priors(priors, track_block, np.arange(len(priors)))
    slow = match(tracks, targets.batch(part), settings)
    fast = compiled_matcher(detections, detection_block, threshold)(tracks, part)
    if not all(np.array_equal(*columns) for columns in zip(slow, fast, strict=True)):
        costs = [
            np.sort(cost_of("ciou_3d", priors[pairs.track], detections[pairs.detection]))
            for pairs in (slow, fast)
        ]
        assert costs[1] == pytest.approx(costs[0], abs=PAIR_TOLERANCE)
    return len(fast.track)


@given(st.integers(0, 10**6), st.integers(1, 60), st.integers(1, 60), st.floats(1.0, 1.9))
def test_crowds(seed: int, tracks: int, detections: int, threshold: float) -> None:
    rng = np.random.default_rng(seed)
    start = int(rng.integers(0, detections))
    assert_same_pairs(
        boxes_around(rng, tracks),
        rng.integers(0, 3, tracks),
        boxes_around(rng, detections),
        rng.integers(0, 3, detections),
        threshold,
        start,
    )


@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e5]))
def test_detections_near_their_tracks_half_turned(seed: int, far_m: float) -> None:
    rng = np.random.default_rng(seed)
    priors = boxes_around(rng, 30) + np.array([far_m, -far_m, 0, 0, 0, 0, 0])
    detections = priors + rng.normal(0, 0.05, priors.shape)
    detections[:, 6] += np.pi * rng.integers(-1, 2, 30)
    order = rng.permutation(30)
    block = np.zeros(30, np.int64)
    assert assert_same_pairs(priors, block, detections[order], block) >= 25


@given(st.integers(0, 10**6))
def test_boxes_that_share_edges_and_corners_cost_the_same(seed: int) -> None:
    """Sizes and places that are whole metres, headings that are quarter turns."""
    rng = np.random.default_rng(seed)
    boxes = np.zeros((2, 1, 7))
    boxes[..., :2] = rng.integers(-2, 3, (2, 1, 2))
    boxes[..., 3:6] = rng.integers(1, 4, (2, 1, 3))
    boxes[..., 6] = 0.5 * np.pi * rng.integers(-2, 3, (2, 1))
    prior, detection = boxes
    (cost,) = cost_of("ciou_3d", prior, detection)
    assume(cost < MOST_COST)
    block = np.zeros(1, np.int64)
    for threshold, found in ((cost + PAIR_TOLERANCE, 1), (cost - PAIR_TOLERANCE, 0)):
        matching = compiled_matcher(detection, block, threshold)
        assert len(matching(Priors(prior, block, block), slice(0, 1)).track) == found


def test_far_blocks() -> None:
    """Blocks of many sequences lie far apart in the layout, and each finds its own."""
    rng = np.random.default_rng(0)
    priors = boxes_around(rng, 200)
    block = rng.integers(0, 10**6, 200)
    found = assert_same_pairs(priors, block, priors + 0.01, block)
    assert found > 190


@pytest.mark.parametrize(("tracks", "detections"), [(0, 5), (5, 0), (0, 0)])
def test_empty_sides(tracks: int, detections: int) -> None:
    rng = np.random.default_rng(1)
    matching = compiled_matcher(boxes_around(rng, 8), np.zeros(8, np.int64), 1.3)
    priors, block = boxes_around(rng, tracks), np.zeros(tracks, np.int64)
    assert not len(matching(Priors(priors, block, block), slice(2, 2 + detections)).track)


def test_what_is_not_a_number_is_not_matched() -> None:
    rng = np.random.default_rng(4)
    priors = boxes_around(rng, 12)
    detections = priors.copy()
    priors[0, 0] = priors[1, 1] = priors[2, 6] = detections[3, 0] = detections[4, 3] = np.nan
    block = np.zeros(12, np.int64)
    tracks = Priors(priors, block, np.arange(12))
    found = compiled_matcher(detections, block, 1.3)(tracks, slice(0, 12))
    assert {(i, i) for i in range(5, 12)} <= set(zip(*found, strict=True))
    assert not set(found.track) & {0, 1, 2}
    assert not set(found.detection) & {3, 4}


def arguments(detections: np.ndarray) -> list[Any]:
    rows = np.empty((2, 4), np.int64)
    none = np.zeros(4, np.int64)
    return [np.ones((7, 4)), none, none, detections, np.zeros(6, np.int64), *rows, 0, 6, 1.0, 1.3]


@pytest.mark.parametrize(
    ("place", "wrong"),
    [
        (0, np.ones((6, 4))),
        (0, np.ones((4, 7)).T),
        (0, np.ones((7, 4), np.float32)),
        (0, np.ones(28)),
        (0, "priors"),
        (1, np.zeros(3, np.int64)),
        (1, np.zeros(4, np.int32)),
        (2, np.zeros(3, np.int64)),
        (3, np.zeros((6, 14))[:, ::2]),
        (3, np.zeros((6, 6))),
        (4, np.zeros(5, np.int64)),
        (5, np.zeros(3, np.int64)),
        (6, np.zeros(3, np.int64)),
        (7, -1),
        (7, 7),
        (8, 7),
        (8, -(2**63)),
        (8, 2**80),
        (9, "1"),
    ],
)
def test_what_does_not_fit_is_refused(kernels: ModuleType, place: int, wrong: object) -> None:
    right = arguments(boxes_around(np.random.default_rng(2), 6))
    assert kernels.match(*right) >= 0
    right[place] = wrong
    with pytest.raises((ValueError, TypeError, OverflowError)):
        kernels.match(*right)
    with pytest.raises(ValueError, match="number of arguments"):
        kernels.match(*right[:-1])


def test_what_is_written_must_be_writable(kernels: ModuleType) -> None:
    right = arguments(boxes_around(np.random.default_rng(3), 6))
    right[5].flags.writeable = False
    with pytest.raises(ValueError, match="read-only"):
        kernels.match(*right)


def test_a_box_that_is_none_takes_no_match_from_others(kernels: ModuleType) -> None:
    """Of long vehicles: how far to look is told by the largest detection of all sequences."""
    track = np.array([[0, 0, 1, 12, 2.5, 3.5, 0]], float)
    seen = np.array(
        [[9, 0, 1, 12, 2.5, 3.5, 0], [300, 0, 1, np.nan, 1, 1, 0], [400, 0, 1, 0.5, 0.5, 0.5, 0]]
    )
    block = np.zeros(3, np.int64)
    for order in ([0, 1, 2], [1, 0, 2], [2, 1, 0]):
        tracks = Priors(track, block[:1], block[:1])
        pairs = compiled_matcher(seen[order], block, 1.3)(tracks, slice(0, 3))
        assert pairs.detection.tolist() == [order.index(0)]


def test_of_tracks_that_cost_the_same_the_lower_rank_is_matched(kernels: ModuleType) -> None:
    """In whatever order they are given: compiled and in numpy."""
    box = np.array([[0, 0, 1, 4.5, 1.8, 1.5, 0.3]])
    settings = AssociationSettings()
    block = np.zeros(3, np.int64)
    for rank in ([0, 1, 2], [2, 0, 1], [1, 2, 0]):
        tracks = Priors(np.tile(box, (3, 1)), block, np.array(rank))
        seen, seen_block = np.tile(box, (2, 1)), block[:2]
        compiled = compiled_matcher(seen, seen_block, settings.threshold)(tracks, slice(0, 2))
        for pairs in (compiled, match(tracks, lay_out(seen, seen_block, settings), settings)):
            assert pairs.track.tolist() == [rank.index(0), rank.index(1)]
            assert pairs.detection.tolist() == [0, 1]
