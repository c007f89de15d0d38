"""Labelled objects with the detections that belong to them: what filters are trained on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from hbbatch.boxes import BOX_FIELDS, FloatArray, transform_boxes
from hbbatch.config import AssociationSettings
from hbbatch.tracking.association import Pairs, associate
from hbbatch.tracking.frames import IntArray, SequenceFrames

_MATCHING = AssociationSettings(cost="ciou_3d", max_cost=1.2)


@dataclass(frozen=True)
class Trajectories:
    """Trajectories of labelled objects, one row an object and frame, object after object.

    Attributes:
        first_row: `(objects,)` first row of each object.
        length: `(objects,)` rows of each object, one a frame without a hole.
        kind_code: `(objects,)`.
        truth: `(n, 7)` labelled boxes, world frame.
        measured: `(n, 7)` detected boxes, world frame; the truth where nothing was detected.
        seen: `(n,)` whether something was detected.
        sight_m: `(n, 3)` from the sensor to the box centre, world axes.
        score: `(n,)` detection score as logged, 0 where nothing was detected.
        dt_s: `(n,)` seconds since the object's previous row.
    """

    first_row: IntArray
    length: IntArray
    kind_code: IntArray
    truth: FloatArray
    measured: FloatArray
    seen: NDArray[np.bool_]
    sight_m: FloatArray
    score: FloatArray
    dt_s: FloatArray


def trajectories(
    labels: pa.Table,
    frames: SequenceFrames,
    class_names: Sequence[str],
    kind_of_class: Mapping[str, int],
) -> Trajectories:
    """Labelled objects of one sequence and the detections matched to them frame by frame.

    Args:
        labels: table of `schema.LABELS`.
        frames: detections of the same sequence, codes indexing `class_names`.
        class_names: classes of `frames`.
        kind_of_class: kind code of every class to be used.
    """
    objects = _objects(labels, list(kind_of_class))
    frame = objects["frame_index"].to_numpy().astype(np.int64)
    sensor = np.stack([objects[name].to_numpy() for name in BOX_FIELDS], axis=1)
    truth = transform_boxes(sensor, frames.rotation[frame], frames.translation_m[frame])
    kind = np.array([kind_of_class[name] for name in objects["class_name"].to_pylist()], np.int64)
    kind_of_code = np.array([kind_of_class[name] for name in class_names])
    pairs = _matched(truth, frame, kind, frames, kind_of_code)
    seen = np.zeros(len(frame), bool)
    seen[pairs.track] = True
    first = _run_starts(objects["object_id"].to_numpy(), frame)
    timestamp = frames.timestamp_ns[frame]
    dt_s = np.diff(timestamp, prepend=timestamp[:1]) * 1e-9
    dt_s[first] = 0.0
    return Trajectories(
        first_row=first,
        length=np.diff(first, append=len(frame)),
        kind_code=kind[first],
        truth=truth,
        measured=_replaced(truth, pairs, frames.boxes),
        seen=seen,
        sight_m=_replaced(truth[:, :3] - frames.translation_m[frame], pairs, frames.sight_m),
        score=_replaced(np.zeros(len(frame)), pairs, frames.scores),
        dt_s=dt_s,
    )


def _objects(labels: pa.Table, classes: list[str]) -> pa.Table:
    """Labels of the wanted classes that have an identity, object after object."""
    known = pc.is_in(labels["class_name"], pa.array(classes))
    kept = labels.filter(pc.and_(known, pc.greater_equal(labels["object_id"], 0)))
    return kept.sort_by([("object_id", "ascending"), ("frame_index", "ascending")])


def _matched(
    truth: FloatArray, frame: IntArray, kind: IntArray, frames: SequenceFrames, kinds: IntArray
) -> Pairs:
    """Labels (as `track`) and detections of the same frame and kind that belong together."""
    count = max(kind.max(initial=0), kinds.max(initial=0)) + 1
    detection_frame = np.repeat(np.arange(frames.frame_count), np.diff(frames.offsets))
    detection_block = detection_frame * count + kinds[frames.class_codes]
    return associate(truth, frame * count + kind, frames.boxes, detection_block, _MATCHING)


def _replaced(values: FloatArray, pairs: Pairs, by: FloatArray) -> FloatArray:
    """Values of labels, those of the matched detections where there is one."""
    replaced = values.copy()
    replaced[pairs.track] = by[pairs.detection]
    return replaced


def join(parts: Sequence[Trajectories]) -> Trajectories:
    """Trajectories of several sequences as one."""
    rows = np.cumsum([0] + [len(part.seen) for part in parts])[:-1]
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])
    }
    shift = np.repeat(rows, [len(part.first_row) for part in parts])
    columns["first_row"] = columns["first_row"] + shift
    return Trajectories(**columns)


def _run_starts(object_id: IntArray, frame: IntArray) -> IntArray:
    """First rows of stretches of one object without a hole in its frames."""
    new = (np.diff(object_id, prepend=-1) != 0) | (np.diff(frame, prepend=-2) != 1)
    return np.flatnonzero(new)
