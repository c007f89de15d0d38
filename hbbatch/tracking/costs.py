"""What it costs to say that a detection is a track, pair by pair, and how far a pair can be apart.

Costs are computed on shapes: what they need to know of a box, worked out once a box and not once a
pair, a column a box.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from hbbatch.boxes import HEIGHT, LENGTH, YAW, FloatArray, X, Z
from hbbatch.config import CostName
from hbbatch.overlap import rectangle_intersection

CostFunction = Callable[[FloatArray, FloatArray], FloatArray]
"""From shapes of priors and of detections, both `(SHAPE_ROWS, n)`, to costs `(n,)`."""

_Z = 0
PLAN: Final = slice(1, 3)
"""Rows of x and y."""
_CENTRE = slice(0, 3)
_COS, _SIN, _MINUS_SIN = 3, 4, 5
_HALF = slice(6, 9)
"""Rows of half the length, width and height."""
_HALF_SIDES = slice(6, 8)
_AREA, _VOLUME, _ASPECT = 9, 10, 11
SHAPE_ROWS: Final = 12


def shapes_of(boxes: FloatArray) -> FloatArray:
    """Shapes `(SHAPE_ROWS, n)` of boxes `(n, 7)`."""
    columns, shapes = boxes.T, np.empty((SHAPE_ROWS, len(boxes)))
    shapes[_Z], shapes[PLAN] = columns[Z], columns[X:Z]
    np.cos(columns[YAW], out=shapes[_COS])
    np.sin(columns[YAW], out=shapes[_SIN])
    np.negative(shapes[_SIN], out=shapes[_MINUS_SIN])
    length, width, height = sizes = columns[LENGTH : HEIGHT + 1]
    np.multiply(sizes, 0.5, out=shapes[_HALF])
    np.multiply(length, width, out=shapes[_AREA])
    np.multiply(shapes[_AREA], height, out=shapes[_VOLUME])
    np.arctan2(length, width, out=shapes[_ASPECT])
    return shapes


def reach_m(shapes: FloatArray, cost: CostName, threshold: float) -> FloatArray:
    """Radii such that no pair further apart than their sum can cost less than the threshold.

    Distance costs: the threshold itself. CIoU: a pair cheaper than τ has d² < (IoU + τ − 1)·c²;
    with IoU > 0 the circumscribed circles meet, with IoU = 0 the enclosing diagonal is at most
    d + r₁ + √2·r₂, which bounds d.
    """
    if cost in ("l2", "l2_size"):
        return np.full(shapes.shape[1], 0.5 * threshold)
    radius = np.sqrt(_squared(shapes[_HALF]))
    radius *= reach_over_radius(threshold)
    return radius


def reach_over_radius(threshold: float) -> float:
    """How far a box can be matched by CIoU, over the radius of its circumscribed sphere."""
    ratio = min(math.sqrt(max(threshold - 1.0, 0.0)), 0.9)
    return max(1.0, math.sqrt(2.0) * ratio / (1.0 - ratio))


def ciou_3d(priors: FloatArray, detections: FloatArray) -> FloatArray:
    """1 − CIoU of rotated volumes (Zheng et al. 2021), pair by pair.

    The enclosing box is upright in the prior's heading frame, so the cost does not depend on how
    the world's axes lie.
    """
    around = _around(priors, detections)
    shared = _shared_footprint(priors, detections, around, axes=3)
    shared *= around.overlap[2]
    iou = shared / (priors[_VOLUME] + detections[_VOLUME] - shared)
    return _ciou_cost(iou, around.spread(3), priors, detections)


def ciou_2d(priors: FloatArray, detections: FloatArray) -> FloatArray:
    """1 − CIoU of rotated footprints, pair by pair."""
    around = _around(priors, detections)
    shared = _shared_footprint(priors, detections, around, axes=2)
    iou = shared / (priors[_AREA] + detections[_AREA] - shared)
    return _ciou_cost(iou, around.spread(2), priors, detections)


def l2(priors: FloatArray, detections: FloatArray) -> FloatArray:
    """Distance of centres in metres, pair by pair."""
    distance: FloatArray = np.sqrt(_squared(priors[_CENTRE] - detections[_CENTRE]))
    return distance


def l2_size(priors: FloatArray, detections: FloatArray) -> FloatArray:
    """Distance of centres plus distance of sizes in metres, pair by pair."""
    return l2(priors, detections) + 2.0 * np.sqrt(_squared(priors[_HALF] - detections[_HALF]))


COSTS: Final[dict[CostName, CostFunction]] = {
    "ciou_3d": ciou_3d,
    "ciou_2d": ciou_2d,
    "l2": l2,
    "l2_size": l2_size,
}


class _Around(NamedTuple):
    """Boxes around a detection, upright in the heading frame of the prior, pair by pair.

    Attributes:
        pose: `(4, n)` of the detection seen from the prior, see `overlap.relative_pose`.
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
        spread = _squared(self.distance[:axes])
        spread /= _squared(self.span[:axes])
        return spread


def _around(priors: FloatArray, detections: FloatArray) -> _Around:
    pose = _pose(priors, detections)
    distance, half = np.empty((2, 3, pose.shape[1]))
    np.abs(pose[:2], out=distance[:2])
    np.subtract(detections[_Z], priors[_Z], out=distance[2])
    np.abs(distance[2], out=distance[2])
    cos, sin = np.abs(pose[2:])
    sides = detections[_HALF_SIDES]
    np.multiply(sides, cos, out=half[:2])
    half[:2] += sides[::-1] * sin
    half[2] = detections[_HALF.stop - 1]
    # One box within the other along an axis reaches no further than the difference of the two.
    reach = priors[_HALF] + half
    half -= priors[_HALF]
    apart = np.maximum(np.abs(half), distance)
    return _Around(pose, distance, reach + apart, reach - apart)


def _pose(priors: FloatArray, detections: FloatArray) -> FloatArray:
    """Centre and direction of the detection, both turned into the frame of the prior, `(4, n)`."""
    pose = np.empty((2, 2, priors.shape[1]))
    np.subtract(detections[PLAN], priors[PLAN], out=pose[0])
    pose[1] = detections[_COS : _SIN + 1]
    crossed = pose[:, ::-1] * priors[_SIN : _MINUS_SIN + 1]
    pose *= priors[_COS]
    pose += crossed
    return pose.reshape(4, priors.shape[1])


def _shared_footprint(
    priors: FloatArray, detections: FloatArray, around: _Around, axes: int
) -> FloatArray:
    """Footprint intersection, computed only where boxes may meet."""
    (meet,) = (np.minimum.reduce(around.overlap[:axes]) > 0.0).nonzero()
    shared = np.zeros(priors.shape[1])
    shared[meet] = rectangle_intersection(
        around.pose.take(meet, axis=1),
        detections[_HALF_SIDES].take(meet, axis=1),
        priors[_HALF_SIDES].take(meet, axis=1),
    )
    return shared


def _ciou_cost(
    iou: FloatArray, spread: FloatArray, priors: FloatArray, detections: FloatArray
) -> FloatArray:
    """1 − (IoU − spread − β·v), v the aspect term and spread the squared distance ratio."""
    v = priors[_ASPECT] - detections[_ASPECT]
    v *= v
    v *= 4.0 / np.pi**2
    rest = 1.0 - iou
    cost: FloatArray = v + rest
    np.maximum(cost, 1e-12, out=cost)
    v *= v
    np.divide(v, cost, out=cost)
    cost += rest
    cost += spread
    return cost


def _squared(vectors: FloatArray) -> FloatArray:
    """Squared lengths of the columns."""
    squared: FloatArray = np.einsum("ij,ij->j", vectors, vectors)
    return squared
