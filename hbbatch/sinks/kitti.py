"""Tracks as a KITTI tracking result file (Geiger et al., CVPR 2012; devkit's readme.txt).

One line a track and frame: `frame id type truncated occluded alpha left top right bottom height
width length x y z rotation_y score`, in the camera's axes (x right, y down, z forward), (x, y, z)
the centre of the bottom face, angles in [-π, π), pixels in the image, truncated and occluded -1.
"""

from __future__ import annotations

import io
import re
from typing import Final

import numpy as np
import pyarrow as pa
from pyarrow import csv

from hbbatch.boxes import BOX_FIELDS, HEIGHT, LENGTH, WIDTH, YAW, FloatArray, X, Y, Z, wrap_angle
from hbbatch.projection import Camera

_DECIMALS: Final = 4
_SPELLINGS: Final = {"dont_care": "DontCare"}
_LAYOUT: Final = csv.WriteOptions(include_header=False, delimiter=" ", quoting_style="none")


def kitti_result(tracks: pa.Table, camera: Camera | None) -> bytes:
    """The content of a sequence's result file.

    Args:
        tracks: table of `schema.TRACKS`.
        camera: gives the 2D boxes; boxes wholly outside its image are left out. Without a camera
            all boxes are written and their 2D box is -1 -1 -1 -1.

    Returns:
        Lines of text in ASCII; nothing at all where there is no track.
    """
    sensor_boxes = np.stack([tracks[f"sensor_{name}"].to_numpy() for name in BOX_FIELDS], axis=1)
    if camera is None:
        rectangles = np.full((tracks.num_rows, 4), -1.0)
    else:
        rectangles = camera.outlines(sensor_boxes, tracks["class_name"].to_numpy())
    seen = ~np.isnan(rectangles[:, 0])
    return _text(tracks.filter(pa.array(seen)), sensor_boxes[seen], rectangles[seen])


def kitti_type(class_name: str) -> str:
    """KITTI's spelling of a normalised class name: one word, capitalised."""
    return _SPELLINGS.get(class_name) or re.sub(r"\s+", "_", class_name.strip()).capitalize()


def _text(tracks: pa.Table, sensor_boxes: FloatArray, rectangles: FloatArray) -> bytes:
    if not tracks.num_rows:
        return b""
    camera_boxes, rotation_y = _in_camera_axes(sensor_boxes)
    alpha = wrap_angle(rotation_y - np.arctan2(camera_boxes[:, 3], camera_boxes[:, 5]))
    unknown = np.full(tracks.num_rows, -1, np.int8)
    kinds = tracks["class_name"].combine_chunks().dictionary_encode()
    spelled = pa.array([kitti_type(name) for name in kinds.dictionary.to_pylist()])
    columns = [
        tracks["frame_index"].combine_chunks(),
        tracks["track_id"].combine_chunks(),
        spelled.take(kinds.indices),
        unknown,
        unknown,
        *map(_rounded, (alpha, *rectangles.T, *camera_boxes.T, rotation_y)),
        _rounded(tracks["track_score"].to_numpy()),
    ]
    buffer = io.BytesIO()
    table = pa.Table.from_arrays([*map(pa.array, columns)], [str(i) for i in range(len(columns))])
    csv.write_csv(table, buffer, _LAYOUT)
    return buffer.getvalue()


def _in_camera_axes(boxes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`(n, 6)` height, width, length, x, y, z of the bottom centre, and `(n,)` rotation_y."""
    bottom = -boxes[:, Z] + boxes[:, HEIGHT] / 2
    sizes = boxes[:, HEIGHT], boxes[:, WIDTH], boxes[:, LENGTH]
    camera_boxes = np.stack([*sizes, -boxes[:, Y], bottom, boxes[:, X]], axis=1)
    return camera_boxes, wrap_angle(-boxes[:, YAW] - np.pi / 2)


def _rounded(values: FloatArray) -> FloatArray:
    """To a tenth of a millimetre, a pixel or a milliradian; adding zero rids of minus zero."""
    rounded: FloatArray = np.round(values, _DECIMALS) + 0.0
    return rounded
