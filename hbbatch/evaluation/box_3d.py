"""The same metrics on rotated 3D boxes, for datasets without a camera.

Similarity is the intersection over union of the volumes, in the sensor frame. Labels with occlusion
level above 2 (hidden from the sensor) or truncation above 0 may be tracked or not, as in KITTI's
protocol; there are no ignore regions and no least size.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from hbbatch.boxes import BOX_FIELDS, BOX_SIZE, FloatArray
from hbbatch.evaluation.columns import floats, integers
from hbbatch.evaluation.metrics import ClassTracks, ClassTruth, kitti_dataset, score_class
from hbbatch.evaluation.results import Evaluation
from hbbatch.overlap import iou_3d


def evaluate_boxes(
    labels: dict[str, pa.Table], tracks: dict[str, pa.Table], classes: Sequence[str]
) -> Evaluation:
    """Scores of 3D boxes, per class.

    Args:
        labels: labels tables (`schema.LABELS`) by sequence id.
        tracks: tracks tables (`schema.TRACKS`) by sequence id; an absent one holds no tracks.
        classes: normalised class names.

    Raises:
        SequenceError: two boxes of a frame carry the same identity.
        MissingExtraError: TrackEval is not installed.
    """
    scores = {
        name: score_class(
            {s: box_truth(table, name) for s, table in labels.items()},
            {s: _class_tracks(table, name) for s, table in tracks.items()},
            _dataset(),
        )
        for name in classes
    }
    return Evaluation("box_3d", scores)


def box_truth(labels: pa.Table, class_name: str) -> ClassTruth:
    """Labelled objects of a class, with their boxes in the sensor frame."""
    wanted = pc.and_(
        pc.equal(labels["class_name"], class_name), pc.greater_equal(labels["object_id"], 0)
    )
    objects = labels.filter(wanted).sort_by("frame_index")
    return ClassTruth(
        frame_index=integers(objects, "frame_index"),
        object_id=integers(objects, "object_id"),
        boxes=floats(objects, BOX_FIELDS),
        look_alike=np.zeros(objects.num_rows, bool),
        occlusion=integers(objects, "occlusion"),
        truncation=integers(objects, "truncation"),
        ignored_frame_index=np.empty(0, np.int64),
        ignored_regions=np.empty((0, BOX_SIZE)),
    )


def _class_tracks(tracks: pa.Table, class_name: str) -> ClassTracks:
    wanted = tracks.filter(pc.equal(tracks["class_name"], class_name)).sort_by("frame_index")
    return ClassTracks(
        frame_index=integers(wanted, "frame_index"),
        track_id=integers(wanted, "track_id"),
        boxes=floats(wanted, [f"sensor_{name}" for name in BOX_FIELDS]),
        track_score=floats(wanted, ["track_score"])[:, 0],
    )


@functools.cache
def _dataset() -> Any:
    """KITTI's preprocessing with another similarity and no least size."""
    dataset = copy.copy(kitti_dataset())
    dataset._calculate_similarities = volume_iou
    dataset.min_height = -np.inf
    return dataset


def volume_iou(first: FloatArray, second: FloatArray) -> FloatArray:
    """Every box of `(n, 7)` against every one of `(m, 7)`, `(n, m)`."""
    pairs = np.indices((len(first), len(second))).reshape(2, -1)
    iou = iou_3d(first[pairs[0]], second[pairs[1]])
    return iou.reshape(len(first), len(second))
