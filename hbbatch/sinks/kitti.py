"""Tracks as a KITTI tracking result file (Geiger et al., CVPR 2012; devkit's readme.txt).

One line a track and frame: `frame id type truncated occluded alpha left top right bottom height
width length x y z rotation_y score`, in the camera's axes (x right, y down, z forward), (x, y, z)
the centre of the bottom face, angles in [-π, π), pixels in the image, truncated and occluded -1.
"""

from __future__ import annotations

import io
import re
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import csv

from hbbatch import schema
from hbbatch.boxes import BOX_FIELDS, HEIGHT, LENGTH, WIDTH, YAW, FloatArray, X, Y, Z, wrap_angle
from hbbatch.packed import kernels
from hbbatch.packed.arrays import IntArray
from hbbatch.projection import Camera

_DECIMALS: Final = 4
_LONGEST_NUMBER: Final = 22
"""Bytes of a number and what is between it and the next, at most."""
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
    kind, names = schema.codes(tracks["class_name"])
    if camera is None:
        rectangles = np.full((tracks.num_rows, 4), -1.0)
    else:
        rectangles = camera.outlines(sensor_boxes, kind, names)
    seen = ~np.isnan(rectangles[:, 0])
    lines = _Lines(
        tracks["frame_index"].to_numpy()[seen].astype(np.int64),
        tracks["track_id"].to_numpy()[seen],
        kind[seen],
        [kitti_type(name) for name in names],
        _values(sensor_boxes[seen], rectangles[seen], tracks["track_score"].to_numpy()[seen]),
    )
    return lines.compiled() or lines.text()


def kitti_type(class_name: str) -> str:
    """KITTI's spelling of a normalised class name: one word, capitalised."""
    return _SPELLINGS.get(class_name) or re.sub(r"\s+", "_", class_name.strip()).capitalize()


def _values(boxes: FloatArray, rectangles: FloatArray, score: FloatArray) -> FloatArray:
    """The numbers of a line that may have decimals, `(15, n)`."""
    camera_boxes, rotation_y = _in_camera_axes(boxes)
    alpha = wrap_angle(rotation_y - np.arctan2(camera_boxes[3], camera_boxes[5]))
    unknown = np.full(len(boxes), -1.0)
    return np.stack(
        [unknown, unknown, alpha, *rectangles.T, *camera_boxes, rotation_y, score],
    )


def _in_camera_axes(boxes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`(6, n)` height, width, length, x, y, z of the bottom centre, and `(n,)` rotation_y."""
    bottom = -boxes[:, Z] + boxes[:, HEIGHT] / 2
    sizes = boxes[:, HEIGHT], boxes[:, WIDTH], boxes[:, LENGTH]
    camera_boxes = np.stack([*sizes, -boxes[:, Y], bottom, boxes[:, X]])
    return camera_boxes, wrap_angle(-boxes[:, YAW] - np.pi / 2)


class _Lines(NamedTuple):
    """What is to be written, a line a box.

    Attributes:
        frame_index, track_id: `(n,)`.
        kind: `(n,)` which of the words.
        words: spellings of classes.
        values: `(15, n)` written to a tenth of a millimetre, a pixel or a milliradian.
    """

    frame_index: IntArray
    track_id: IntArray
    kind: IntArray
    words: list[str]
    values: FloatArray

    def compiled(self) -> bytes:
        """The text by the compiled kernel; nothing where it is not built or a value is too large.

        Arrow writes such values, and not numbers, in ways of its own.
        """
        if not kernels.AVAILABLE:
            return b""
        words = [word.encode() for word in self.words]
        ends = np.cumsum([0, *map(len, words)], dtype=np.int64)
        numbers, longest = 2 + len(self.values), max(map(len, words), default=0)
        text = np.empty(len(self.kind) * (longest + _LONGEST_NUMBER * numbers), np.uint8)
        length = kernels.lines(
            self.frame_index, self.track_id, self.kind, b"".join(words), ends, self.values, text
        )
        return text[: max(length, 0)].tobytes()

    def text(self) -> bytes:
        """The same text by Arrow."""
        if not len(self.kind):
            return b""
        rounded = np.round(self.values, _DECIMALS) + 0.0  # which rids of minus zero
        spelled = pa.array(self.words).take(pa.array(self.kind))
        columns = [
            *map(pa.array, (self.frame_index, self.track_id)),
            spelled,
            *map(pa.array, rounded),
        ]
        table = pa.Table.from_arrays(columns, [str(i) for i in range(len(columns))])
        buffer = io.BytesIO()
        csv.write_csv(table, buffer, _LAYOUT)
        return buffer.getvalue()
