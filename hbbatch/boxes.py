"""The one box convention, and the geometry that depends on nothing else.

A box is `[x, y, z, length, width, height, yaw]`: metres and radians, right-handed frame with z up,
(x, y, z) the centre of the box, yaw about z measured from x, length along the heading.
Arrays of boxes have shape `(n, 7)` and dtype float64 unless said otherwise.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

BOX_FIELDS: Final = ("x", "y", "z", "length", "width", "height", "yaw")
X, Y, Z, LENGTH, WIDTH, HEIGHT, YAW = range(7)
BOX_SIZE: Final = 7

_UNIT_CORNERS: Final[FloatArray] = np.array(
    [
        [0.5, 0.5, -0.5],
        [0.5, -0.5, -0.5],
        [-0.5, -0.5, -0.5],
        [-0.5, 0.5, -0.5],
        [0.5, 0.5, 0.5],
        [0.5, -0.5, 0.5],
        [-0.5, -0.5, 0.5],
        [-0.5, 0.5, 0.5],
    ]
)


LARGEST: Final = 2e7
"""Of any value of a box: coordinates of a map (UTM) go so far. Sizes and angles are far below."""


def are_boxes(boxes: FloatArray) -> NDArray[np.bool_]:
    """Which rows `(n, 7)` can be boxes: finite, on this earth, of some size."""
    on_earth = (np.abs(boxes) <= LARGEST).all(axis=1)
    sized = (boxes[:, LENGTH : HEIGHT + 1] > 0.0).all(axis=1)
    return np.asarray(on_earth & sized, dtype=np.bool_)


def wrap_angle(angle_rad: FloatArray) -> FloatArray:
    """Angles wrapped to [-π, π)."""
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi


def rotation_matrices(quaternions: FloatArray) -> FloatArray:
    """Rotation matrices `(n, 3, 3)` of quaternions `(n, 4)` x, y, z, w of any length but zero."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def corners(boxes: FloatArray) -> FloatArray:
    """The eight corners of each box.

    Args:
        boxes: `(n, 7)`.

    Returns:
        `(n, 8, 3)` in the frame of the boxes: bottom face clockwise from front left, then the top.
    """
    local = _UNIT_CORNERS * boxes[:, None, LENGTH : HEIGHT + 1]
    cos, sin = np.cos(boxes[:, YAW, None]), np.sin(boxes[:, YAW, None])
    turned = np.stack(
        [
            cos * local[..., 0] - sin * local[..., 1],
            sin * local[..., 0] + cos * local[..., 1],
            local[..., 2],
        ],
        axis=-1,
    )
    return turned + boxes[:, None, :3]


def transform_boxes(
    boxes: FloatArray, rotation: FloatArray, translation_m: FloatArray
) -> FloatArray:
    """Boxes moved to another frame by a rigid transform, one a box or one for all.

    A box stays upright: its heading is the horizontal direction of the rotated heading vector, so
    roll and pitch of the transform move its centre but do not tilt it.

    Args:
        boxes: `(n, 7)` in the source frame.
        rotation: target_from_source, `(3, 3)` or `(n, 3, 3)`.
        translation_m: target_from_source, `(3,)` or `(n, 3)`.

    Returns:
        `(n, 7)` in the target frame, yaw in [-π, π).
    """
    moved = boxes.copy()
    moved[:, :3] = np.einsum("...ij,...j->...i", rotation, boxes[:, :3]) + translation_m
    heading = np.stack([np.cos(boxes[:, YAW]), np.sin(boxes[:, YAW])], axis=-1)
    turned = np.einsum("...ij,...j->...i", rotation[..., :2, :2], heading)
    moved[:, YAW] = wrap_angle(np.arctan2(turned[:, 1], turned[:, 0]))
    return moved
