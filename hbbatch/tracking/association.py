"""Which detection belongs to which track: candidate pairs, costs, greedy one-stage matching.

All sequences of a lock step are matched in one pass: a pair is a candidate only if both sides lie
in the same block (sequence and class), so results do not depend on who shares the step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import HEIGHT, LENGTH, WIDTH, YAW, FloatArray, X
from hbbatch.config import AssociationSettings, CostName
from hbbatch.overlap import footprint_intersection, shared_height, volume

IntArray = NDArray[np.int64]
CostFunction = Callable[[FloatArray, FloatArray], FloatArray]


class Pairs(NamedTuple):
    """Candidate pairs as row numbers of tracks and of detections."""

    track: IntArray
    detection: IntArray

    def take(self, rows: NDArray[np.generic]) -> Pairs:
        """Pairs chosen by mask or index."""
        return Pairs(self.track[rows], self.detection[rows])


def associate(
    priors: FloatArray,
    track_block: IntArray,
    detections: FloatArray,
    detection_block: IntArray,
    settings: AssociationSettings,
) -> Pairs:
    """Greedy one-stage association (paper, section III-C).

    Args:
        priors: `(n, 7)` prior boxes of tracks, world frame.
        track_block: `(n,)` block of each track; only equal blocks can match.
        detections: `(m, 7)` detected boxes, world frame.
        detection_block: `(m,)`.
        settings: cost and threshold.

    Returns:
        Matched pairs, at most one a track and one a detection.
    """
    threshold = settings.threshold
    track_reach, detection_reach = _reach(priors, detections, settings.cost, threshold)
    pairs = candidates(
        priors, track_block, track_reach, detections, detection_block, detection_reach
    )
    costs = COSTS[settings.cost](priors[pairs.track], detections[pairs.detection])
    affordable = np.flatnonzero(costs < threshold)
    order = affordable[np.argsort(costs[affordable], kind="stable")]
    return greedy(pairs.take(order))


def candidates(
    priors: FloatArray,
    track_block: IntArray,
    track_reach: FloatArray,
    detections: FloatArray,
    detection_block: IntArray,
    detection_reach: FloatArray,
) -> Pairs:
    """Pairs of equal block whose centres are closer than the sum of their reaches.

    A sweep along x: detections are sorted once, every track looks up the strip it can reach, so
    the work grows with neighbours and not with tracks × detections.
    """
    if not len(priors) or not len(detections):
        return Pairs(np.empty(0, np.int64), np.empty(0, np.int64))
    order = np.lexsort((detections[:, X], detection_block))
    x = detections[order, X]
    # One sortable key a block: blocks are laid side by side along x, further apart than any reach.
    origin = min(x.min(), priors[:, X].min())
    reach = track_reach + detection_reach.max()
    spacing = max(x.max(), priors[:, X].max()) - origin + 2.0 * reach.max() + 1.0
    sorted_key = detection_block[order] * spacing + (x - origin)
    key = track_block * spacing + (priors[:, X] - origin)
    first = np.searchsorted(sorted_key, key - reach)
    count = np.searchsorted(sorted_key, key + reach, side="right") - first
    track = np.repeat(np.arange(len(priors)), count)
    skipped = np.cumsum(count) - count
    detection = order[np.arange(len(track)) - (skipped - first)[track]]
    limit = track_reach[track] + detection_reach[detection]
    near = priors[track, :2] - detections[detection, :2]
    kept = np.flatnonzero(np.einsum("ij,ij->i", near, near) < limit * limit)
    return Pairs(track[kept], detection[kept])


def greedy(pairs: Pairs) -> Pairs:
    """Greedy matching of pairs sorted by cost: the cheapest free pair is taken, again and again.

    In each round every pair that comes first for its track and for its detection is taken; no
    cheaper pair could have claimed either, so this is the sequential algorithm in a few passes.
    """
    if not len(pairs.track):
        return pairs
    taken_pairs = []
    first_of_track = np.empty(pairs.track.max() + 1, np.int64)
    first_of_detection = np.empty(pairs.detection.max() + 1, np.int64)
    while len(pairs.track):
        number = np.arange(len(pairs.track))
        # Written backwards, so that the first occurrence is what remains.
        first_of_track[pairs.track[::-1]] = number[::-1]
        first_of_detection[pairs.detection[::-1]] = number[::-1]
        best_for_track = first_of_track[pairs.track]
        best_for_detection = first_of_detection[pairs.detection]
        taken = (best_for_track == number) & (best_for_detection == number)
        taken_pairs.append(pairs.take(taken))
        pairs = pairs.take(~(taken[best_for_track] | taken[best_for_detection]))
    return Pairs(
        np.concatenate([p.track for p in taken_pairs]),
        np.concatenate([p.detection for p in taken_pairs]),
    )


def ciou_3d(priors: FloatArray, detections: FloatArray) -> FloatArray:
    """1 − CIoU of rotated volumes (Zheng et al. 2021), pair by pair.

    The enclosing box is upright in the prior's heading frame, so the cost does not depend on how
    the world's axes lie.
    """
    shared = footprint_intersection(detections, priors) * shared_height(detections, priors)
    iou = shared / (volume(priors) + volume(detections) - shared)
    difference = detections[:, :3] - priors[:, :3]
    diagonal = _enclosing_footprint(priors, detections)
    rise = np.abs(difference[:, 2])
    diagonal += _span(rise, priors[:, HEIGHT], detections[:, HEIGHT]) ** 2
    distance = np.einsum("ij,ij->i", difference, difference)
    return _ciou_cost(iou, distance / diagonal, priors, detections)


def ciou_2d(priors: FloatArray, detections: FloatArray) -> FloatArray:
    """1 − CIoU of rotated footprints, pair by pair."""
    shared = footprint_intersection(detections, priors)
    area = priors[:, LENGTH] * priors[:, WIDTH] + detections[:, LENGTH] * detections[:, WIDTH]
    difference = detections[:, :2] - priors[:, :2]
    distance = np.einsum("ij,ij->i", difference, difference)
    spread = distance / _enclosing_footprint(priors, detections)
    return _ciou_cost(shared / (area - shared), spread, priors, detections)


def l2(priors: FloatArray, detections: FloatArray) -> FloatArray:
    """Distance of centres in metres, pair by pair."""
    distance: FloatArray = np.linalg.norm(priors[:, :3] - detections[:, :3], axis=1)
    return distance


def l2_size(priors: FloatArray, detections: FloatArray) -> FloatArray:
    """Distance of centres plus distance of sizes in metres, pair by pair."""
    size = priors[:, LENGTH : HEIGHT + 1] - detections[:, LENGTH : HEIGHT + 1]
    cost: FloatArray = l2(priors, detections) + np.linalg.norm(size, axis=1)
    return cost


COSTS: Final[dict[CostName, CostFunction]] = {
    "ciou_3d": ciou_3d,
    "ciou_2d": ciou_2d,
    "l2": l2,
    "l2_size": l2_size,
}


def _ciou_cost(
    iou: FloatArray, spread: FloatArray, priors: FloatArray, detections: FloatArray
) -> FloatArray:
    """1 − (IoU − spread − β·v), v the aspect term and spread the squared distance ratio."""
    aspect = np.arctan(priors[:, LENGTH] / priors[:, WIDTH]) - np.arctan(
        detections[:, LENGTH] / detections[:, WIDTH]
    )
    v = (4.0 / np.pi**2) * aspect**2
    weight = v / np.maximum(1.0 - iou + v, 1e-12)
    cost: FloatArray = 1.0 - iou + spread + weight * v
    return cost


def _enclosing_footprint(priors: FloatArray, detections: FloatArray) -> FloatArray:
    """Squared diagonal of the rectangle around both, upright in the prior's heading frame."""
    cos, sin = np.cos(priors[:, YAW]), np.sin(priors[:, YAW])
    dx, dy = (detections[:, :2] - priors[:, :2]).T
    along, across = np.abs(cos * dx + sin * dy), np.abs(cos * dy - sin * dx)
    turn = detections[:, YAW] - priors[:, YAW]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    length, width = detections[:, LENGTH], detections[:, WIDTH]
    diagonal: FloatArray = _span(along, priors[:, LENGTH], cos * length + sin * width) ** 2
    diagonal += _span(across, priors[:, WIDTH], sin * length + cos * width) ** 2
    return diagonal


def _span(distance: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Length of the interval around two centred intervals whose centres lie `distance` apart."""
    span: FloatArray = np.maximum(distance + 0.5 * (first + second), np.maximum(first, second))
    return span


def _reach(
    priors: FloatArray, detections: FloatArray, cost: CostName, threshold: float
) -> tuple[FloatArray, FloatArray]:
    """Radii such that no pair further apart than their sum can cost less than the threshold.

    Distance costs: the threshold itself. CIoU: a pair cheaper than τ has d² < (IoU + τ − 1)·c²;
    with IoU > 0 the circumscribed circles meet, with IoU = 0 the enclosing diagonal is at most
    d + r₁ + √2·r₂, which bounds d.
    """
    if cost in ("l2", "l2_size"):
        half = 0.5 * threshold
        return np.full(len(priors), half), np.full(len(detections), half)
    ratio = min(np.sqrt(max(threshold - 1.0, 0.0)), 0.9)
    stretch = max(1.0, np.sqrt(2.0) * ratio / (1.0 - ratio))
    return stretch * _radius(priors), stretch * _radius(detections)


def _radius(boxes: FloatArray) -> FloatArray:
    radius: FloatArray = 0.5 * np.linalg.norm(boxes[:, LENGTH : HEIGHT + 1], axis=1)
    return radius
