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

_EDGE_TURNS: Final = np.array([[[0, 2], [0, 1]], [[1, 0], [2, 0]]])
"""`(axis, rectangle, along or across)`: which of cosine, sine and minus sine of the turn half a
side has along an axis of the other rectangle."""

_AROUND: Final = np.array([[[-1.0], [1.0]], [[1.0], [-1.0]]])
"""`(along or across, side, 1)`: which way the boundary runs along the edges of a rectangle."""


def footprint_intersection(first: FloatArray, second: FloatArray) -> FloatArray:
    """Area shared by the footprints of boxes, pair by pair.

    Args:
        first: `(n, 7)` boxes.
        second: `(n, 7)` boxes in the same frame.

    Returns:
        `(n,)` m².
    """
    sides = slice(LENGTH, WIDTH + 1)
    half_first, half_second = 0.5 * first.T[sides], 0.5 * second.T[sides]
    return rectangle_intersection(relative_pose(first, second), half_first, half_second)


def relative_pose(first: FloatArray, second: FloatArray) -> FloatArray:
    """Where the first boxes are in the frames of the second ones, pair by pair.

    Returns:
        `(4, n)`: centre along and across the second box's heading, cosine and sine of the turn.
    """
    pose = np.empty((4, len(first)))
    x, y = first[:, X] - second[:, X], first[:, Y] - second[:, Y]
    angles = np.stack([second[:, YAW], first[:, YAW] - second[:, YAW]])
    (cos, pose[2]), (sin, pose[3]) = np.cos(angles), np.sin(angles)
    np.add(cos * x, sin * y, out=pose[0])
    np.subtract(cos * y, sin * x, out=pose[1])
    return pose


def rectangle_intersection(
    pose: FloatArray, first_half: FloatArray, second_half: FloatArray
) -> FloatArray:
    """Area shared by rectangles, pair by pair.

    Each rectangle is looked at in the frame of the other, where the other one is upright. Both
    are held in one array, so that a few operations serve all edges of both.

    Args:
        pose: `(4, n)` of the first in the frame of the second, from `relative_pose`.
        first_half: `(2, n)` half of length and width.
        second_half: `(2, n)`.
    """
    half = np.empty((2, *first_half.shape))
    np.multiply(first_half, _GROWTH, out=half[0])
    half[1] = second_half
    turn = np.empty((3, pose.shape[1]))
    turn[:2] = pose[2:]
    np.negative(pose[3], out=turn[2])
    edge = turn.take(_EDGE_TURNS, axis=0)
    edge *= half
    middle = _edge_middles(_mutual_centres(pose[:2], turn), edge)
    inside = _length_inside(middle, edge, half[::-1].swapaxes(0, 1))
    cross = middle[0, 0] * edge[1, 0, :, None]
    cross -= middle[1, 0] * edge[0, 0, :, None]
    cross *= _AROUND
    area: FloatArray = np.einsum("asn,asn->n", cross, inside[0])
    area += np.einsum("asn->n", inside[1]) * (second_half[0] * second_half[1])
    area *= 0.5
    np.maximum(area, 0.0, out=area)
    return area


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


def _mutual_centres(centre: FloatArray, turn: FloatArray) -> FloatArray:
    """`(axis, rectangle, n)` centre of each rectangle in the frame of the other one."""
    centres = np.empty((2, 2, centre.shape[1]))
    centres[:, 0] = centre
    back = centre * turn[0]
    back += centre[::-1] * turn[1:]
    np.negative(back, out=centres[:, 1])
    return centres


def _edge_middles(centre: FloatArray, edge: FloatArray) -> FloatArray:
    """`(axis, rectangle, along or across, side, n)` middles of the edges that run that way."""
    middle = np.empty((2, 2, 2, 2, centre.shape[-1]))
    np.add(centre[:, :, None], edge[:, :, ::-1], out=middle[:, :, :, 0])
    np.subtract(centre[:, :, None], edge[:, :, ::-1], out=middle[:, :, :, 1])
    return middle


def _length_inside(middle: FloatArray, edge: FloatArray, limit: FloatArray) -> FloatArray:
    """`(rectangle, along or across, side, n)` half sides of each edge inside the other rectangle.

    An edge is middle + t·edge, t from -1 to 1; `limit` `(axis, rectangle, n)` is half the size of
    the upright rectangle that cuts it.
    """
    # Adding next to nothing changes an edge only where it is zero.
    inverse = np.reciprocal(edge + _TINY)
    ends = np.empty((2, *middle.shape))
    np.multiply(middle, inverse[:, :, :, None], out=ends[0])
    np.negative(ends[0], out=ends[1])
    np.abs(inverse, out=inverse)
    inverse *= limit[:, :, None]
    ends += inverse[:, :, :, None]
    # How far the edge is inside to either end, seen from its middle.
    inside = np.minimum(ends[:, 0], ends[:, 1])
    np.minimum(inside, 1.0, out=inside)
    length: FloatArray = inside[0] + inside[1]
    np.maximum(length, 0.0, out=length)
    return length
