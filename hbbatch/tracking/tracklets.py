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
from hbbatch.tracking.association import associate
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
    known = pc.is_in(labels["class_name"], pa.array(list(kind_of_class)))
    kept = labels.filter(pc.and_(known, pc.greater_equal(labels["object_id"], 0)))
    kept = kept.sort_by([("object_id", "ascending"), ("frame_index", "ascending")])
    frame = kept["frame_index"].to_numpy().astype(np.int64)
    sensor = np.stack([kept[name].to_numpy() for name in BOX_FIELDS], axis=1)
    truth = transform_boxes(sensor, frames.rotation[frame], frames.translation_m[frame])
    kind = np.array([kind_of_class[name] for name in kept["class_name"].to_pylist()], np.int64)
    kinds = max(kind_of_class.values()) + 1
    kind_of_code = np.array([kind_of_class[name] for name in class_names])
    detection_frame = np.repeat(np.arange(frames.frame_count), np.diff(frames.offsets))
    pairs = associate(
        truth,
        frame * kinds + kind,
        frames.boxes,
        detection_frame * kinds + kind_of_code[frames.class_codes],
        _MATCHING,
    )
    measured, score = truth.copy(), np.zeros(len(frame))
    seen = np.zeros(len(frame), bool)
    sight_m = truth[:, :3] - frames.translation_m[frame]
    seen[pairs.track] = True
    measured[pairs.track] = frames.boxes[pairs.detection]
    score[pairs.track] = frames.scores[pairs.detection]
    sight_m[pairs.track] = frames.sight_m[pairs.detection]
    timestamp = frames.timestamp_ns[frame]
    first = _run_starts(kept["object_id"].to_numpy(), frame)
    dt_s = np.diff(timestamp, prepend=timestamp[:1]) * 1e-9
    dt_s[first] = 0.0
    return Trajectories(
        first,
        np.diff(first, append=len(frame)),
        kind[first],
        truth,
        measured,
        seen,
        sight_m,
        score,
        dt_s,
    )


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
