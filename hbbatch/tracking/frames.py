"""What the tracker is given: the detections of one sequence in the world frame, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from hbbatch.boxes import (
    BOX_FIELDS,
    FloatArray,
    are_boxes,
    rotation_matrices,
    transform_boxes,
)
from hbbatch.errors import SequenceError

IntArray = NDArray[np.int64]

DETECTION_COLUMNS: Final = (
    *("frame_index", "detection_id", "class_name", "score"),
    *BOX_FIELDS,
)
"""What tracking reads of `schema.DETECTIONS`."""

_TRANSLATION = tuple(f"translation_{axis}" for axis in "xyz")
_ROTATION = tuple(f"rotation_{axis}" for axis in "xyzw")

POSE_COLUMNS: Final = ("timestamp_ns", *_TRANSLATION, *_ROTATION)
"""What tracking reads of `schema.POSES`."""


@dataclass(frozen=True)
class SequenceFrames:
    """Detections of one sequence, sorted by frame; rows of frame f are offsets[f]:offsets[f + 1].

    Attributes:
        sequence_id: name of the sequence.
        timestamp_ns: `(frames,)` time of each frame.
        offsets: `(frames + 1,)` first detection row of each frame.
        boxes: `(n, 7)` in the world frame.
        sight_m: `(n, 3)` from the sensor to the box centre, world axes.
        scores: `(n,)` as logged.
        class_codes: `(n,)` index into the class names the tracker was asked for.
        detection_ids: `(n,)` ids in the detections table.
        world_from_sensor: rotations `(frames, 3, 3)` and translations `(frames, 3)`.
    """

    sequence_id: str
    timestamp_ns: IntArray
    offsets: IntArray
    boxes: FloatArray
    sight_m: FloatArray
    scores: FloatArray
    class_codes: IntArray
    detection_ids: IntArray
    rotation: FloatArray
    translation_m: FloatArray

    @property
    def frame_count(self) -> int:
        """Frames of the sequence, empty ones included."""
        return len(self.timestamp_ns)

    def part(self, first: int, stop: int) -> SequenceFrames:
        """Frames `first` to before `stop` as a sequence of their own."""
        frames = slice(first, stop)
        start, end = self.offsets[first], self.offsets[stop]
        rows = slice(start, end)
        return SequenceFrames(
            sequence_id=self.sequence_id,
            timestamp_ns=self.timestamp_ns[frames],
            offsets=self.offsets[first : stop + 1] - start,
            boxes=self.boxes[rows],
            sight_m=self.sight_m[rows],
            scores=self.scores[rows],
            class_codes=self.class_codes[rows],
            detection_ids=self.detection_ids[rows],
            rotation=self.rotation[frames],
            translation_m=self.translation_m[frames],
        )


def sequence_frames(
    sequence_id: str,
    detections: pa.Table,
    poses: pa.Table,
    classes: Sequence[str],
    min_score: float | None = None,
) -> SequenceFrames:
    """Detections of the wanted classes moved to the world frame.

    Args:
        sequence_id: name of the sequence.
        detections: table with `DETECTION_COLUMNS`, sorted by frame.
        poses: table with `POSE_COLUMNS`, a row a frame.
        classes: class names to keep; their order defines `class_codes`.
        min_score: lower scores are dropped.

    Raises:
        SequenceError: a box is not finite, has no size, or lies farther away than any sensor sees.
    """
    kept = detections.filter(pc.is_in(detections["class_name"], pa.array(list(classes))))
    if min_score is not None:
        kept = kept.filter(pc.greater_equal(kept["score"], min_score))
    frame_index = _column(kept, "frame_index").astype(np.int64)
    rotation = rotation_matrices(_columns(poses, _ROTATION))
    translation = _columns(poses, _TRANSLATION)
    sensor_boxes = _columns(kept, BOX_FIELDS)
    _check_boxes(sensor_boxes, sequence_id)
    boxes = transform_boxes(sensor_boxes, rotation[frame_index], translation[frame_index])
    codes = pc.index_in(kept["class_name"], pa.array(list(classes)))
    return SequenceFrames(
        sequence_id=sequence_id,
        timestamp_ns=_column(poses, "timestamp_ns"),
        offsets=np.searchsorted(frame_index, np.arange(poses.num_rows + 1)),
        boxes=boxes,
        sight_m=boxes[:, :3] - translation[frame_index],
        scores=_column(kept, "score"),
        class_codes=codes.to_numpy().astype(np.int64),
        detection_ids=_column(kept, "detection_id"),
        rotation=rotation,
        translation_m=translation,
    )


def _check_boxes(boxes: FloatArray, sequence_id: str) -> None:
    """Whoever wrote the detections: one box that is none spoils the tracks of its sequence."""
    fit = are_boxes(boxes)
    if not fit.all():
        place = int(np.argmin(fit))
        values = ", ".join(
            f"{name} {v:g}" for name, v in zip(BOX_FIELDS, boxes[place], strict=True)
        )
        raise SequenceError(
            f"sequence {sequence_id}: {np.count_nonzero(~fit)} detected boxes are none, the first: "
            f"{values}. Mend what wrote the detections and ingest again."
        )


def _column(table: pa.Table, name: str) -> NDArray[Any]:
    column: NDArray[Any] = table[name].to_numpy()
    return column


def _columns(table: pa.Table, names: Sequence[str]) -> FloatArray:
    return np.stack([table[name].to_numpy() for name in names], axis=1)
