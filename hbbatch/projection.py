"""3D boxes seen by a pinhole camera: the 2D boxes that image-based formats and metrics ask for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import HEIGHT, LENGTH, WIDTH, YAW, FloatArray, X, Y, Z
from hbbatch.errors import DatasetError

NEAR_PLANE_M: Final = 0.1
"""Depth at which edges that run past the camera are cut: nearer points have no useful image."""

BREADTH: Final = {"pedestrian": 0.81}
"""How much of the width of its projected box an object fills, where that is not nearly all of it.

People are narrower than the boxes around their arms and stride. Mean ratio of labelled image boxes
to projected labelled boxes in KITTI's ten labelled training sequences, as measured in
tests/test_projection.py; heights agree, as do the boxes of other classes.
"""

_RING: Final = np.arange(4)
_EDGES: Final = np.concatenate(
    [
        np.stack([_RING, (_RING + 1) % 4], axis=1),
        np.stack([_RING + 4, (_RING + 1) % 4 + 4], axis=1),
        np.stack([_RING, _RING + 4], axis=1),
    ]
)
_FROM: Final = np.concatenate([_EDGES[:, 0], _EDGES[:, 1]])
_TO: Final = np.concatenate([_EDGES[:, 1], _EDGES[:, 0]])


@dataclass(frozen=True)
class Camera:
    """The camera of a sequence, as its `calibration.json` describes it.

    Attributes:
        image_from_sensor: `(3, 4)` projection, homogeneous pixels from sensor metres; its third
            row gives the depth in metres.
        width_px: width of the image.
        height_px: height of the image.
    """

    image_from_sensor: FloatArray
    width_px: float
    height_px: float

    @classmethod
    def from_calibration(cls, calibration: dict[str, Any], what: str) -> Camera:
        """The camera in the content of a calibration file; `what` names it in an error.

        Raises:
            DatasetError: a value is missing or makes no camera.
        """
        try:
            camera = cls(
                np.array(calibration["image_from_sensor"], float).reshape(3, 4),
                float(calibration["image_width_px"]),
                float(calibration["image_height_px"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise DatasetError(
                f"{what}: no usable camera ({error!r}). Ingest the sequence again with --force."
            ) from error
        sizes = np.array([camera.width_px, camera.height_px])
        if not (np.isfinite(camera.image_from_sensor).all() and (sizes > 1).all()):
            raise DatasetError(
                f"{what}: the projection is not finite or the image has no size. "
                "Ingest the sequence again with --force."
            )
        return camera

    def outlines(
        self, boxes_sensor: FloatArray, class_code: NDArray[np.int64], class_names: Sequence[str]
    ) -> FloatArray:
        """Where objects lie in this camera's image, `(n, 4)` as of `image_boxes`.

        Args:
            boxes_sensor: `(n, 7)` in the sensor frame.
            class_code: `(n,)` index into the names.
            class_names: normalised.
        """
        breadth = np.array([BREADTH.get(name, 1.0) for name in class_names])[class_code]
        size_px = self.width_px, self.height_px
        return image_boxes(boxes_sensor, self.image_from_sensor, *size_px, breadth)


def image_boxes(
    boxes_sensor: FloatArray,
    image_from_sensor: FloatArray,
    width_px: float,
    height_px: float,
    breadth: FloatArray | float = 1.0,
) -> FloatArray:
    """The rectangle each box fills in the image.

    The twelve edges of a box are cut at `NEAR_PLANE_M` in front of the camera, so a box that the
    camera is in or beside reaches the edge of the image instead of losing the corners behind it.

    Args:
        boxes_sensor: `(n, 7)` in the sensor frame.
        image_from_sensor: `(3, 4)` projection, homogeneous pixels from sensor metres; its third
            row gives the depth in metres.
        width_px: width of the image.
        height_px: height of the image.
        breadth: `(n,)` share of the rectangle's width that is kept, about its middle.

    Returns:
        `(n, 4)` left, top, right, bottom in pixels, within [0, width_px - 1] x [0, height_px - 1];
        NaN where no part of the box is in the image.
    """
    projected = _projected_corners(boxes_sensor, image_from_sensor)
    cut = (projected[2] < NEAR_PLANE_M).any(axis=0)
    edges = _cut_edges(projected[..., cut])
    projected[2, :, cut] = 1.0  # the camera may lie in a corner
    rectangle = _extent(projected)
    rectangle[..., cut] = _extent(edges)
    low, high = rectangle
    spare = 0.5 * (1.0 - breadth) * (high[0] - low[0])
    low[0] += spare
    high[0] -= spare
    edge = np.array([width_px, height_px]) - 1.0
    np.clip(rectangle, 0.0, edge[:, None], out=rectangle)
    seen = (low < high).all(axis=0)
    rectangle[..., ~seen] = np.nan
    return rectangle.reshape(4, -1).T


def _projected_corners(boxes: FloatArray, image_from_sensor: FloatArray) -> FloatArray:
    """Homogeneous pixels `(3, 8, n)` of corners in the order of `boxes.corners`.

    Boxes come last throughout, so that each operation runs along all of them.
    """
    x, y, z, shift = image_from_sensor[:, :, None].transpose(1, 0, 2)
    cos, sin = np.cos(boxes[:, YAW]), np.sin(boxes[:, YAW])
    along = (x * cos + y * sin) * (0.5 * boxes[:, LENGTH])
    across = (y * cos - x * sin) * (0.5 * boxes[:, WIDTH])
    up = z * (0.5 * boxes[:, HEIGHT])
    centre = x * boxes[:, X] + y * boxes[:, Y] + z * boxes[:, Z] + shift
    projected = np.empty((3, 8, len(boxes)))
    for corner, (ahead, left) in enumerate(((1, 1), (1, -1), (-1, -1), (-1, 1))):
        middle = centre + ahead * along + left * across
        projected[:, corner] = middle - up
        projected[:, corner + 4] = middle + up
    return projected


def _extent(projected: FloatArray) -> FloatArray:
    """Lowest and highest pixel coordinates of each box's points, `(2, 2, n)`; NaN are left out."""
    pixels = projected[:2] / projected[2]
    return np.stack([np.fmin.reduce(pixels, axis=1), np.fmax.reduce(pixels, axis=1)])


def _cut_edges(projected: FloatArray) -> FloatArray:
    """Both ends of every edge after the cut at the near plane; NaN for an edge wholly behind it."""
    start, end = projected[:, _FROM], projected[:, _TO]
    depth, other = start[2], end[2]
    behind = depth < NEAR_PLANE_M
    run = np.where(other == depth, 1.0, other - depth)
    share = np.where(behind, (NEAR_PLANE_M - depth) / run, 0.0)
    ends = start + share * (end - start)
    ends[:, behind & (other < NEAR_PLANE_M)] = np.nan
    return ends
