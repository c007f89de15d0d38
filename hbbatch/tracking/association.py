"""Which detection belongs to which track: candidate pairs, costs, greedy one-stage matching.

All sequences of a lock step are matched in one pass: a pair is a candidate only if both sides lie
in the same block (sequence and class), so results do not depend on who shares the step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import HEIGHT, LENGTH, WIDTH, FloatArray, X, Z
from hbbatch.config import AssociationSettings, CostName
from hbbatch.overlap import rectangle_intersection, relative_pose, volume

IntArray = NDArray[np.int64]
CostFunction = Callable[[FloatArray, FloatArray], FloatArray]


class Pairs(NamedTuple):
    """Candidate pairs as row numbers of tracks and of detections."""

    track: IntArray
    detection: IntArray

    @classmethod
    def none(cls) -> Pairs:
        """No pair."""
        return cls(np.empty(0, np.int64), np.empty(0, np.int64))

    def take(self, rows: NDArray[np.generic]) -> Pairs:
        """Pairs chosen by mask or index."""
        return Pairs(self.track[rows], self.detection[rows])


class Targets(NamedTuple):
    """Detections laid out for matching: block after block, sorted by x within a block.

    Attributes:
        boxes: `(m, 7)` in the order of the caller.
        reach_m: `(m,)` see `_reach`.
        order: `(m,)` row of the boxes at each place of the layout.
        key: `(m,)` position along the layout, ascending: blocks side by side along x.
        low_m, high_m: range of x in which boxes lie.
    """

    boxes: FloatArray
    reach_m: FloatArray
    order: IntArray
    key: FloatArray
    low_m: float
    high_m: float

    def batch(self, start: int, stop: int) -> Targets:
        """One of the batches that `lay_out` kept apart, rows counting from 0 again."""
        rows = slice(start, stop)
        return self._replace(
            boxes=self.boxes[rows],
            reach_m=self.reach_m[rows],
            order=self.order[rows] - start,
            key=self.key[rows],
        )


def lay_out(
    detections: FloatArray,
    block: IntArray,
    settings: AssociationSettings,
    batch: IntArray | None = None,
) -> Targets:
    """Sort detections for matching.

    Args:
        detections: `(m, 7)` detected boxes, world frame.
        block: `(m,)`; a track matches only detections of its own block.
        settings: cost and threshold.
        batch: `(m,)` ascending; batches stay apart, so that each can be matched alone.
    """
    x = detections[:, X]
    keys = (x, block) if batch is None else (x, block, batch)
    order = np.lexsort(keys)
    low, high = x.min(initial=0.0), x.max(initial=0.0)
    key = _key(x[order], block[order], low, high)
    reach = _reach(detections, settings.cost, settings.threshold)
    return Targets(detections, reach, order, key, float(low), float(high))


def _key(x: FloatArray, block: IntArray, low_m: float, high_m: float) -> FloatArray:
    """Position in the layout; x beyond the range stays within a metre of its own block."""
    inside = np.minimum(np.maximum(x, low_m - 1.0), high_m + 1.0)
    inside += block * (high_m - low_m + 3.0)
    return inside


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
    return match(priors, track_block, lay_out(detections, detection_block, settings), settings)


def match(
    priors: FloatArray, track_block: IntArray, targets: Targets, settings: AssociationSettings
) -> Pairs:
    """`associate` with the detections laid out already."""
    threshold = settings.threshold
    reach = _reach(priors, settings.cost, threshold)
    pairs = candidates(priors, track_block, reach, targets)
    costs = COSTS[settings.cost](
        _gather(priors, pairs.track), _gather(targets.boxes, pairs.detection)
    )
    affordable = np.flatnonzero(costs < threshold)
    order = affordable[np.argsort(costs[affordable], kind="stable")]
    return greedy(pairs.take(order))


def _gather(boxes: FloatArray, rows: IntArray) -> FloatArray:
    """Rows of boxes, stored column by column: costs are computed on columns."""
    return np.ascontiguousarray(boxes.take(rows, axis=0).T).T


def candidates(
    priors: FloatArray, track_block: IntArray, track_reach_m: FloatArray, targets: Targets
) -> Pairs:
    """Pairs of equal block whose centres are closer than the sum of their reaches.

    A sweep along x: every track looks up the strip it can reach among the sorted detections, so
    the work grows with neighbours and not with tracks × detections.
    """
    x = priors[:, X]
    bounds = np.empty((2, len(x)))
    strip = track_reach_m + targets.reach_m.max(initial=0.0)
    np.subtract(x, strip, out=bounds[0])
    np.add(x, strip, out=bounds[1])
    first, end = targets.key.searchsorted(_key(bounds, track_block, targets.low_m, targets.high_m))
    count = end - first
    track = np.arange(len(x)).repeat(count)
    place = np.arange(len(track))
    place += (first - (count.cumsum() - count))[track]
    detection = targets.order[place]
    apart = priors[:, :2].take(track, axis=0) - targets.boxes[:, :2].take(detection, axis=0)
    limit = track_reach_m[track] + targets.reach_m[detection]
    near = np.flatnonzero(np.einsum("ij,ij->i", apart, apart) < limit * limit)
    return Pairs(track[near], detection[near])


def greedy(pairs: Pairs) -> Pairs:
    """Greedy matching of pairs sorted by cost: the cheapest free pair is taken, again and again.

    Most pairs have no rival and are taken at once. The others are walked one by one: they are few
    a track, and rounds of array operations to find independent ones would cost more.
    """
    if not len(pairs.track):
        return pairs
    tracks, detections = np.bincount(pairs.track), np.bincount(pairs.detection)
    taken = (tracks[pairs.track] == 1) & (detections[pairs.detection] == 1)
    rivals = np.flatnonzero(~taken)
    track_free, detection_free = bytearray(b"\1") * len(tracks), bytearray(b"\1") * len(detections)
    contested = pairs.take(rivals)
    walk = (rivals.tolist(), contested.track.tolist(), contested.detection.tolist())
    for number, track, detection in zip(*walk, strict=True):
        if track_free[track] and detection_free[detection]:
            track_free[track] = detection_free[detection] = 0
            taken[number] = True
    return pairs.take(np.flatnonzero(taken))


def ciou_3d(priors: FloatArray, detections: FloatArray) -> FloatArray:
    """1 − CIoU of rotated volumes (Zheng et al. 2021), pair by pair.

    The enclosing box is upright in the prior's heading frame, so the cost does not depend on how
    the world's axes lie.
    """
    around = _around(priors, detections)
    meet = np.flatnonzero(around.overlap.min(axis=0) > 0.0)
    shared = _shared_footprint(priors, detections, around.pose, meet) * around.overlap[2]
    iou = shared / (volume(priors) + volume(detections) - shared)
    return _ciou_cost(iou, around.spread(3), priors, detections)


def ciou_2d(priors: FloatArray, detections: FloatArray) -> FloatArray:
    """1 − CIoU of rotated footprints, pair by pair."""
    around = _around(priors, detections)
    meet = np.flatnonzero(around.overlap[:2].min(axis=0) > 0.0)
    shared = _shared_footprint(priors, detections, around.pose, meet)
    area = priors[:, LENGTH] * priors[:, WIDTH] + detections[:, LENGTH] * detections[:, WIDTH]
    return _ciou_cost(shared / (area - shared), around.spread(2), priors, detections)


class _Around(NamedTuple):
    """Boxes around a detection, upright in the heading frame of the prior, pair by pair.

    Attributes:
        pose: `(4, n)` of the detection seen from the prior.
        distance: `(3, n)` of the centres along, across and up.
        span: `(3, n)` extents of the box around both.
        overlap: `(3, n)` how far the box around the detection reaches into the prior; where one
            is not positive the two share nothing.
    """

    pose: FloatArray
    distance: FloatArray
    span: FloatArray
    overlap: FloatArray

    def spread(self, axes: int) -> FloatArray:
        """Squared distance of the centres over the squared diagonal of the box around both."""
        distance, span = self.distance[:axes], self.span[:axes]
        spread: FloatArray = np.einsum("ij,ij->j", distance, distance)
        spread /= np.einsum("ij,ij->j", span, span)
        return spread


def _around(priors: FloatArray, detections: FloatArray) -> _Around:
    pose = relative_pose(detections, priors)
    distance, extent = np.empty((2, 3, len(priors)))
    np.abs(pose[:2], out=distance[:2])
    np.abs(detections[:, Z] - priors[:, Z], out=distance[2])
    cos, sin = np.abs(pose[2:])
    size = priors.T[LENGTH : HEIGHT + 1]
    length, width, extent[2] = detections.T[LENGTH : HEIGHT + 1]
    extent[0] = cos * length + sin * width
    extent[1] = sin * length + cos * width
    reach = 0.5 * (size + extent)
    return _Around(
        pose,
        distance,
        np.maximum(reach + distance, np.maximum(size, extent)),
        np.minimum(reach - distance, np.minimum(size, extent)),
    )


def _shared_footprint(
    priors: FloatArray, detections: FloatArray, pose: FloatArray, meet: IntArray
) -> FloatArray:
    """Footprint intersection, computed only where boxes may meet."""
    shared = np.zeros(len(priors))
    sides = slice(LENGTH, WIDTH + 1)
    shared[meet] = rectangle_intersection(
        pose.take(meet, axis=1),
        detections.T[sides].take(meet, axis=1),
        priors.T[sides].take(meet, axis=1),
    )
    return shared


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
    length, width = priors[:, LENGTH], priors[:, WIDTH]
    other_length, other_width = detections[:, LENGTH], detections[:, WIDTH]
    # The difference of the two aspect angles arctan(length / width), in one go.
    aspect = np.arctan2(
        length * other_width - other_length * width, width * other_width + length * other_length
    )
    v = (4.0 / np.pi**2) * aspect * aspect
    rest = 1.0 - iou
    cost: FloatArray = rest + spread + v * v / np.maximum(rest + v, 1e-12)
    return cost


def _reach(boxes: FloatArray, cost: CostName, threshold: float) -> FloatArray:
    """Radii such that no pair further apart than their sum can cost less than the threshold.

    Distance costs: the threshold itself. CIoU: a pair cheaper than τ has d² < (IoU + τ − 1)·c²;
    with IoU > 0 the circumscribed circles meet, with IoU = 0 the enclosing diagonal is at most
    d + r₁ + √2·r₂, which bounds d.
    """
    if cost in ("l2", "l2_size"):
        return np.full(len(boxes), 0.5 * threshold)
    ratio = min(np.sqrt(max(threshold - 1.0, 0.0)), 0.9)
    stretch = max(1.0, np.sqrt(2.0) * ratio / (1.0 - ratio))
    length, width, height = boxes[:, LENGTH], boxes[:, WIDTH], boxes[:, HEIGHT]
    radius: FloatArray = (0.5 * stretch) * np.sqrt(
        length * length + width * width + height * height
    )
    return radius
