"""Frames and labels as the tables of `hbbatch.schema`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from hbbatch import schema
from hbbatch.boxes import BOX_FIELDS, FloatArray
from hbbatch.sources.base import Frame, Labels
from hbbatch.sources.classes import normalise_class

_IMAGE_SIDES: Final = ("image_left", "image_top", "image_right", "image_bottom")


def detections_table(
    frames: Sequence[Frame], first_frame_index: int, first_detection_id: int
) -> pa.Table:
    """A table of `schema.DETECTIONS` for consecutive frames.

    Args:
        frames: a batch of frames of one sequence, at least one.
        first_frame_index: index of the first of them in the sequence.
        first_detection_id: rows of the sequence before this batch.
    """
    counts = [len(frame.boxes) for frame in frames]
    logged = [name for frame in frames for name in frame.class_names]
    index = np.arange(first_frame_index, first_frame_index + len(frames))
    columns = {
        "frame_index": np.repeat(index, counts),
        "timestamp_ns": np.repeat([frame.timestamp_ns for frame in frames], counts),
        "detection_id": np.arange(first_detection_id, first_detection_id + sum(counts)),
        "class_name": pa.array([normalise_class(name) for name in logged], pa.string()),
        "class_name_logged": pa.array(logged, pa.string()),
        "score": np.concatenate([frame.scores for frame in frames]),
        **_box_columns(np.concatenate([frame.boxes for frame in frames])),
        "frame_id": _repeated([frame.frame_id for frame in frames], counts),
        **_image_columns(np.concatenate([frame.image_boxes for frame in frames])),
        "source_row": np.concatenate([frame.source_rows for frame in frames]),
    }
    return schema.conform(pa.table(columns), schema.DETECTIONS, "detections")


def poses_table(frames: Sequence[Frame], first_frame_index: int) -> pa.Table:
    """A table of `schema.POSES` for consecutive frames, a row a frame."""
    translation_m = np.stack([frame.pose.translation_m for frame in frames])
    rotation = np.stack([frame.pose.rotation for frame in frames])
    columns = {
        "frame_index": np.arange(first_frame_index, first_frame_index + len(frames)),
        "timestamp_ns": pa.array([frame.timestamp_ns for frame in frames], pa.int64()),
        "log_time_ns": pa.array([frame.log_time_ns for frame in frames], pa.int64()),
        **{f"translation_{a}": translation_m[:, i] for i, a in enumerate("xyz")},
        **{f"rotation_{a}": rotation[:, i] for i, a in enumerate("xyzw")},
        "origin": pa.array([frame.pose.origin for frame in frames], pa.string()),
        "frame_id": pa.array([frame.frame_id for frame in frames], pa.string()),
    }
    return schema.conform(pa.table(columns), schema.POSES, "poses")


def labels_table(labels: Labels) -> pa.Table:
    """A table of `schema.LABELS`."""
    names = [normalise_class(name) for name in labels.class_names]
    columns = {
        "frame_index": labels.frame_index,
        "timestamp_ns": labels.timestamp_ns,
        "object_id": labels.object_id,
        "class_name": pa.array(names, pa.string()),
        "class_name_logged": pa.array(labels.class_names, pa.string()),
        **_box_columns(labels.boxes),
        "frame_id": _repeated([labels.frame_id], [len(names)]),
        **_image_columns(labels.image_boxes),
        "truncation": labels.truncation,
        "occlusion": labels.occlusion,
    }
    return schema.conform(pa.table(columns), schema.LABELS, "labels")


def _box_columns(boxes: FloatArray) -> dict[str, pa.Array]:
    return {name: _nan_as_null(boxes[:, i]) for i, name in enumerate(BOX_FIELDS)}


def _image_columns(image_boxes: FloatArray) -> dict[str, pa.Array]:
    return {name: _nan_as_null(image_boxes[:, i]) for i, name in enumerate(_IMAGE_SIDES)}


def _nan_as_null(values: FloatArray) -> pa.Array:
    return pa.array(np.ascontiguousarray(values), from_pandas=True)


def _repeated(names: Sequence[str], counts: Sequence[int]) -> pa.Array:
    repeated: NDArray[np.object_] = np.repeat(np.array(names, dtype=object), counts)
    return pa.array(repeated, pa.string())
