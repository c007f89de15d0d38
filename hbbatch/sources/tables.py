"""Frames and labels as the tables of `hbbatch.schema`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import pyarrow as pa

from hbbatch import schema
from hbbatch.boxes import BOX_FIELDS, FloatArray
from hbbatch.sources.base import FrameBatch, Labels, Names
from hbbatch.sources.classes import Taxonomy

_IMAGE_SIDES: Final = ("image_left", "image_top", "image_right", "image_bottom")


def detections_table(
    batch: FrameBatch, first_frame_index: int, first_detection_id: int, taxonomy: Taxonomy
) -> pa.Table:
    """A table of `schema.DETECTIONS` for consecutive frames, its texts coded.

    Args:
        batch: frames of one sequence.
        first_frame_index: index of the first of them in the sequence.
        first_detection_id: rows of the sequence before this batch.
        taxonomy: what the classes are called.
    """
    counts, logged = batch.box_counts, batch.class_names
    index = np.arange(first_frame_index, first_frame_index + len(counts), dtype=np.int32)
    normalised = Names.of([taxonomy.normalise(name) for name in logged.vocabulary])
    frames = Names(np.repeat(batch.frame_ids.codes, counts), batch.frame_ids.vocabulary)
    columns = {
        "frame_index": np.repeat(index, counts),
        "timestamp_ns": np.repeat(batch.timestamp_ns, counts),
        "detection_id": np.arange(first_detection_id, first_detection_id + len(batch.boxes)),
        "class_name": _text(normalised[logged.codes]),
        "class_name_logged": _text(logged),
        "score": batch.scores,
        **_box_columns(batch.boxes),
        "frame_id": _text(frames),
        **_image_columns(batch.image_boxes),
        "source_row": batch.source_rows,
    }
    return schema.conform(pa.table(columns), schema.coded(schema.DETECTIONS), "detections")


def poses_table(batch: FrameBatch, first_frame_index: int) -> pa.Table:
    """A table of `schema.POSES` for consecutive frames, a row a frame, its texts coded."""
    count = len(batch.timestamp_ns)
    log_time_ns = pa.nulls(count, pa.int64())
    if batch.log_time_ns is not None:
        log_time_ns = pa.array(batch.log_time_ns, pa.int64())
    columns = {
        "frame_index": np.arange(first_frame_index, first_frame_index + count, dtype=np.int32),
        "timestamp_ns": batch.timestamp_ns,
        "log_time_ns": log_time_ns,
        **{f"translation_{a}": batch.poses.translation_m[:, i] for i, a in enumerate("xyz")},
        **{f"rotation_{a}": batch.poses.rotation[:, i] for i, a in enumerate("xyzw")},
        "origin": _text(batch.poses.origins),
        "frame_id": _text(batch.frame_ids),
    }
    return schema.conform(pa.table(columns), schema.coded(schema.POSES), "poses")


def labels_table(labels: Labels, taxonomy: Taxonomy) -> pa.Table:
    """A table of `schema.LABELS`."""
    names = [taxonomy.normalise(name) for name in labels.class_names]
    columns = {
        "frame_index": labels.frame_index,
        "timestamp_ns": labels.timestamp_ns,
        "object_id": labels.object_id,
        "class_name": pa.array(names, pa.string()),
        "class_name_logged": pa.array(labels.class_names, pa.string()),
        **_box_columns(labels.boxes),
        "frame_id": pa.array([labels.frame_id] * len(names), pa.string()),
        **_image_columns(labels.image_boxes),
        "truncation": labels.truncation,
        "occlusion": labels.occlusion,
    }
    return schema.conform(pa.table(columns), schema.LABELS, "labels")


def _box_columns(boxes: FloatArray) -> dict[str, pa.Array]:
    return _columns(BOX_FIELDS, boxes)


def _image_columns(image_boxes: FloatArray) -> dict[str, pa.Array]:
    return _columns(_IMAGE_SIDES, image_boxes)


def _columns(names: Sequence[str], values: FloatArray) -> dict[str, pa.Array]:
    """Columns of numbers, `(n, len(names))`; null where they are NaN."""
    is_nan = np.isnan(values)
    if is_nan.all():
        return {name: pa.nulls(len(values), pa.float64()) for name in names}
    missing = bool(is_nan.any())
    columns = np.ascontiguousarray(values.T)
    return {
        name: pa.array(column, from_pandas=missing)
        for name, column in zip(names, columns, strict=True)
    }


def _text(names: Names) -> pa.DictionaryArray:
    """Texts as codes, with those that are met as dictionary."""
    counts = np.bincount(names.codes, minlength=len(names.vocabulary))
    met = np.flatnonzero(counts)
    numbers = np.zeros(len(counts), dtype=np.int32)
    numbers[met] = np.arange(len(met))
    vocabulary = pa.array([names.vocabulary[code] for code in met.tolist()], pa.string())
    return pa.DictionaryArray.from_arrays(numbers[names.codes], vocabulary)
