"""Which detection belongs to which track: candidate pairs and greedy one-stage matching.

All sequences of a lock step are matched in one pass: a pair is a candidate only if both sides lie
in the same block (sequence and class), so results do not depend on who shares the step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray, X
from hbbatch.config import AssociationSettings
from hbbatch.packed import kernels
from hbbatch.tracking.costs import COSTS, PLAN, reach_m, reach_over_radius, shapes_of
from hbbatch.tracking.frames import IntArray

COMPILED_COST: Final = "ciou_3d"
"""The default; there is a kernel for it, and numpy for all others."""


class Priors(NamedTuple):
    """Tracks to be matched.

    Attributes:
        boxes: `(n, 7)` prior boxes, world frame.
        block: `(n,)`; only detections of the same block can match.
        rank: `(n,)`; of tracks that a detection costs the same the lowest one takes it, in whatever
            order they are given.
    """

    boxes: FloatArray
    block: IntArray
    rank: IntArray


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
        shapes: `(SHAPE_ROWS, m)` see `costs.shapes_of`.
        reach_m: `(m,)` see `costs.reach_m`.
        widest_m: `(m,)` the largest reach in the batch.
        order: `(m,)` number that the caller gave to the detection at each place.
        key: `(m,)` position along the layout, ascending: blocks side by side along x.
        low_m, high_m: range of x in which boxes lie.
    """

    shapes: FloatArray
    reach_m: FloatArray
    widest_m: FloatArray
    order: IntArray
    key: FloatArray
    low_m: float
    high_m: float

    def batch(self, rows: slice) -> Targets:
        """One of the batches that `lay_out` kept apart."""
        return Targets(
            self.shapes[:, rows],
            self.reach_m[rows],
            self.widest_m[rows],
            self.order[rows],
            self.key[rows],
            self.low_m,
            self.high_m,
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
    # One whole number for batch and block, as a third key would take as long as the other two.
    outer = block if batch is None else batch * (int(block.max(initial=0)) + 1) + block
    order = np.lexsort((x, outer))
    low, high = float(x.min(initial=0.0)), float(x.max(initial=0.0))
    shapes = shapes_of(detections[order])
    reach = reach_m(shapes, settings.cost, settings.threshold)
    widest = _largest_of_batch(reach, np.zeros(len(x)) if batch is None else batch[order])
    key = _key(x[order], block[order], low, high)
    return Targets(shapes, reach, widest, order, key, low, high)


def _largest_of_batch(values: FloatArray, batch: NDArray[np.generic]) -> FloatArray:
    """The largest value of each one's batch; batches lie together."""
    if not len(values):
        return values
    (new,) = (batch[1:] != batch[:-1]).nonzero()
    starts = np.concatenate([[0], new + 1])
    largest: FloatArray = np.maximum.reduceat(values, starts)
    return largest.repeat(np.diff(starts, append=len(values)))


def _key(x: FloatArray, block: IntArray, low_m: float, high_m: float) -> FloatArray:
    """Position in the layout; x beyond the range stays within a metre of its own block."""
    inside = np.maximum(x, low_m - 1.0)
    np.minimum(inside, high_m + 1.0, out=inside)
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
        Matched pairs, at most one a track and one a detection, the cheapest first.
    """
    matching = matcher(detections, detection_block, settings)
    tracks = Priors(priors, track_block, np.arange(len(priors)))
    return matching(tracks, slice(0, len(detections)))


Matcher = Callable[[Priors, slice], Pairs]
"""Matches tracks to a slice of the detections."""


def matcher(
    detections: FloatArray,
    block: IntArray,
    settings: AssociationSettings,
    batch: IntArray | None = None,
) -> Matcher:
    """`associate` for batches of detections that are known beforehand.

    The default cost is compiled where there was a compiler, all others are not.

    Args:
        detections: `(m, 7)` detected boxes, world frame.
        block: `(m,)`; a track matches only detections of its own block.
        settings: cost and threshold.
        batch: `(m,)` ascending; slices that are matched are batches. None: all are one.
    """
    if kernels.AVAILABLE and settings.cost == COMPILED_COST:
        return compiled_matcher(detections, block, settings.threshold)
    targets = lay_out(detections, block, settings, batch)
    return lambda priors, part: match(priors, targets.batch(part), settings)


def compiled_matcher(detections: FloatArray, block: IntArray, threshold: float) -> Matcher:
    """The compiled kernel of the cost ciou_3d."""
    boxes, stretch = np.ascontiguousarray(detections), reach_over_radius(threshold)

    def match_compiled(priors: Priors, part: slice) -> Pairs:
        rows, numbers = np.empty((2, min(len(priors.boxes), part.stop - part.start)), np.int64)
        count = kernels.match(
            np.ascontiguousarray(priors.boxes.T),
            priors.block,
            priors.rank,
            boxes,
            block,
            rows,
            numbers,
            part.start,
            part.stop,
            stretch,
            threshold,
        )
        return Pairs(rows[:count], numbers[:count])

    return match_compiled


def match(priors: Priors, targets: Targets, settings: AssociationSettings) -> Pairs:
    """`associate` with a batch of detections laid out already, in numpy."""
    if not len(targets.order):
        return Pairs.none()
    shapes = shapes_of(priors.boxes)
    reach = reach_m(shapes, settings.cost, settings.threshold)
    pairs = candidates(shapes[PLAN], priors.block, reach, targets)
    costs = COSTS[settings.cost](
        shapes.take(pairs.track, axis=1), targets.shapes.take(pairs.detection, axis=1)
    )
    affordable = np.count_nonzero(costs < settings.threshold)
    order = np.lexsort((priors.rank[pairs.track], costs))
    found = greedy(pairs.take(order[:affordable]))
    return Pairs(found.track, targets.order[found.detection])


def candidates(
    plan_m: FloatArray, track_block: IntArray, track_reach_m: FloatArray, targets: Targets
) -> Pairs:
    """Pairs of equal block whose centres are closer than the sum of their reaches.

    A sweep along x: every track looks up the strip it can reach among the sorted detections, so
    the work grows with neighbours and not with tracks × detections.

    Args:
        plan_m: `(2, n)` x and y of the tracks.
        track_block: `(n,)`.
        track_reach_m: `(n,)`.
        targets: one batch of detections, at least one.

    Returns:
        Tracks by row, detections by place in the layout.
    """
    x = plan_m[0]
    bounds = np.empty((2, len(x)))
    strip = track_reach_m + targets.widest_m[0]
    np.subtract(x, strip, out=bounds[0])
    np.add(x, strip, out=bounds[1])
    first, end = targets.key.searchsorted(_key(bounds, track_block, targets.low_m, targets.high_m))
    count = end - first
    track = np.arange(len(x)).repeat(count)
    first -= count.cumsum() - count
    place = np.arange(len(track))
    place += first[track]
    apart = plan_m.take(track, axis=1)
    apart -= targets.shapes[PLAN].take(place, axis=1)
    apart *= apart
    limit = track_reach_m[track]
    limit += targets.reach_m[place]
    limit *= limit
    (near,) = (apart[0] + apart[1] < limit).nonzero()
    return Pairs(track[near], place[near])


def greedy(pairs: Pairs) -> Pairs:
    """Greedy matching of pairs sorted by cost: the cheapest free pair is taken, again and again.

    Walked one by one: candidates are few a track, and array operations to find those without
    rivals would cost more.
    """
    tracks, detections, taken = set(), set(), []
    walk = zip(pairs.track.tolist(), pairs.detection.tolist(), strict=True)
    for number, (track, detection) in enumerate(walk):
        if track not in tracks and detection not in detections:
            tracks.add(track)
            detections.add(detection)
            taken.append(number)
    return pairs.take(np.array(taken, np.int64))
