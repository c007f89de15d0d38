"""How much two boxes overlap, pair by pair (numpy).

The footprint intersection is exact for rotated rectangles and needs no polygon library: by Green's
theorem the area of a convex intersection is half the sum of cross(p, q) over its boundary pieces,
and those are the parts of each rectangle's edges that lie inside the other one.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hbbatch.boxes import HEIGHT, LENGTH, WIDTH, YAW, FloatArray, X, Y, Z

_GROWTH: Final = 1.0 + 1e-9
"""One of the two rectangles is grown by this, so that edges never coincide exactly: a shared edge
would be counted twice, or not at all."""

_TINY: Final = 1e-300
_CORNER_X: Final = np.array([0.5, -0.5, -0.5, 0.5])
_CORNER_Y: Final = np.array([0.5, 0.5, -0.5, -0.5])


def footprint_intersection(first: FloatArray, second: FloatArray) -> FloatArray:
    """Area shared by the footprints of boxes, pair by pair.

    Args:
        first: `(n, 7)` boxes.
        second: `(n, 7)` boxes in the same frame.

    Returns:
        `(n,)` m².
    """
    turn = first[:, YAW] - second[:, YAW]
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    offset_x, offset_y = _rotate(
        first[:, X] - second[:, X], first[:, Y] - second[:, Y], -second[:, YAW]
    )
    # Corners of the first rectangle in the frame of the second, and the other way round.
    along, across = _corners(first, _GROWTH)
    first_x = offset_x[:, None] + cos * along - sin * across
    first_y = offset_y[:, None] + sin * along + cos * across
    along, across = _corners(second, 1.0)
    second_x = cos * (along - offset_x[:, None]) + sin * (across - offset_y[:, None])
    second_y = cos * (across - offset_y[:, None]) - sin * (along - offset_x[:, None])

    inside_second = _share_inside(first_x, first_y, second, 1.0)
    next_x, next_y = _next(first_x), _next(first_y)
    area = np.sum(inside_second * (first_x * next_y - first_y * next_x), axis=1)
    inside_first = _share_inside(second_x, second_y, first, _GROWTH)
    area += np.sum(inside_first, axis=1) * (second[:, LENGTH] * second[:, WIDTH] * 0.5)
    shared: FloatArray = np.maximum(0.5 * area, 0.0)
    return shared


def iou_bev(first: FloatArray, second: FloatArray) -> FloatArray:
    """Intersection over union of the footprints, pair by pair, `(n,)`."""
    shared = footprint_intersection(first, second)
    union = first[:, LENGTH] * first[:, WIDTH] + second[:, LENGTH] * second[:, WIDTH] - shared
    iou: FloatArray = shared / union
    return iou


def iou_3d(first: FloatArray, second: FloatArray) -> FloatArray:
    """Intersection over union of the volumes, pair by pair, `(n,)`."""
    shared = footprint_intersection(first, second) * shared_height(first, second)
    iou: FloatArray = shared / (volume(first) + volume(second) - shared)
    return iou


def volume(boxes: FloatArray) -> FloatArray:
    """Volume of each box in m³."""
    product: FloatArray = boxes[:, LENGTH] * boxes[:, WIDTH] * boxes[:, HEIGHT]
    return product


def shared_height(first: FloatArray, second: FloatArray) -> FloatArray:
    """Height in metres over which boxes overlap, pair by pair, at least 0."""
    half_first, half_second = first[:, HEIGHT] / 2, second[:, HEIGHT] / 2
    top = np.minimum(first[:, Z] + half_first, second[:, Z] + half_second)
    bottom = np.maximum(first[:, Z] - half_first, second[:, Z] - half_second)
    height: FloatArray = np.maximum(top - bottom, 0.0)
    return height


def _rotate(x: FloatArray, y: FloatArray, angle_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return cos * x - sin * y, sin * x + cos * y


def _corners(boxes: FloatArray, growth: float) -> tuple[FloatArray, FloatArray]:
    """Corners `(n, 4)` counter-clockwise in each box's own frame."""
    return (
        boxes[:, LENGTH, None] * (growth * _CORNER_X),
        boxes[:, WIDTH, None] * (growth * _CORNER_Y),
    )


def _next(corner: FloatArray) -> FloatArray:
    return corner[:, [1, 2, 3, 0]]


def _share_inside(x: FloatArray, y: FloatArray, box: FloatArray, growth: float) -> FloatArray:
    """Share of each edge x[i], y[i] → next corner inside an upright rectangle at the origin."""
    enter_x, leave_x = _crossings(x, box[:, LENGTH, None] * (0.5 * growth))
    enter_y, leave_y = _crossings(y, box[:, WIDTH, None] * (0.5 * growth))
    enter = np.maximum(np.maximum(enter_x, enter_y), 0.0)
    leave = np.minimum(np.minimum(leave_x, leave_y), 1.0)
    share: FloatArray = np.maximum(leave - enter, 0.0)
    return share


def _crossings(start: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where along each edge (0 start, 1 end) a coordinate enters and leaves [-half, half]."""
    step = _next(start) - start
    step = np.where(np.abs(step) < _TINY, _TINY, step)
    with np.errstate(over="ignore"):
        low, high = (-half - start) / step, (half - start) / step
    return np.minimum(low, high), np.maximum(low, high)
