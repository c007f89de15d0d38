"""KITTI's official 2D tracking protocol (HOTA version) on the labels table.

Car: vans may be tracked or not. Pedestrian: so may seated persons. Objects truncated at the image
border or largely occluded may be tracked or not; tracks in DontCare regions or at most 25 pixels
high do not count against a tracker. KITTI's server evaluates these two classes; cyclists are
evaluated in the same way, without a look-alike class, as its detection benchmark does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from hbbatch import schema
from hbbatch.boxes import BOX_FIELDS, FloatArray
from hbbatch.evaluation.columns import floats, integers
from hbbatch.evaluation.metrics import ClassTracks, ClassTruth, kitti_dataset, score_class
from hbbatch.evaluation.results import Evaluation
from hbbatch.projection import Camera

KITTI_CLASSES: Final = ("car", "pedestrian", "cyclist")
_LOOK_ALIKES: Final = {
    "car": ("van",),
    "pedestrian": ("person", "person_sitting"),
    "cyclist": (),
}
_IMAGE_BOX: Final = ("image_left", "image_top", "image_right", "image_bottom")

KittiTruth = dict[str, dict[str, ClassTruth]]
"""Labels by class name, then by sequence id: parsed once, evaluated against many times."""
KittiTracks = dict[str, dict[str, ClassTracks]]
"""Tracks by class name, then by sequence id."""


def evaluate_kitti(truth: KittiTruth, tracks: KittiTracks) -> Evaluation:
    """Scores in KITTI's protocol of every class and sequence of `truth`.

    Raises:
        SequenceError: a track has two boxes in one frame.
        MissingExtraError: TrackEval is not installed.
    """
    scores = {
        name: score_class(by_sequence, tracks.get(name, {}), kitti_dataset())
        for name, by_sequence in truth.items()
    }
    return Evaluation("kitti_2d", scores)


def kitti_truth(labels: dict[str, pa.Table], classes: Sequence[str] = KITTI_CLASSES) -> KittiTruth:
    """What there is to find, from labels tables (`schema.LABELS`) by sequence id."""
    return {
        name: {sequence_id: _class_truth(table, name) for sequence_id, table in labels.items()}
        for name in classes
    }


def _class_truth(labels: pa.Table, class_name: str) -> ClassTruth:
    labels = labels.sort_by("frame_index")
    logged = pc.utf8_lower(labels["class_name_logged"])
    wanted = pc.is_in(logged, pa.array([class_name, *_LOOK_ALIKES[class_name]]))
    # As in TrackEval, an object without an identity is no object.
    objects = labels.filter(pc.and_(wanted, pc.greater_equal(labels["object_id"], 0)))
    regions = labels.filter(pc.equal(logged, "dontcare"))
    names = pc.utf8_lower(objects["class_name_logged"])
    return ClassTruth(
        frame_index=integers(objects, "frame_index"),
        object_id=integers(objects, "object_id"),
        boxes=floats(objects, _IMAGE_BOX),
        look_alike=np.asarray(pc.not_equal(names, class_name).to_numpy(), bool),
        occlusion=integers(objects, "occlusion"),
        truncation=integers(objects, "truncation"),
        ignored_frame_index=integers(regions, "frame_index"),
        ignored_regions=floats(regions, _IMAGE_BOX),
    )


def kitti_tracks(
    tracks: dict[str, pa.Table],
    cameras: dict[str, Camera],
    classes: Sequence[str] = KITTI_CLASSES,
) -> KittiTracks:
    """What was found, from tracks tables (`schema.TRACKS`), projected to the image.

    Args:
        tracks: tracks tables by sequence id.
        cameras: camera of each sequence.
        classes: class names to keep.
    """
    projected = {
        sequence_id: _projected(table, cameras[sequence_id])
        for sequence_id, table in tracks.items()
    }
    return {
        name: {s: _of_class(table, boxes, name) for s, (table, boxes) in projected.items()}
        for name in classes
    }


def _projected(tracks: pa.Table, camera: Camera) -> tuple[pa.Table, FloatArray]:
    tracks = tracks.sort_by("frame_index")
    boxes = floats(tracks, [f"sensor_{name}" for name in BOX_FIELDS])
    return tracks, camera.outlines(boxes, *schema.codes(tracks["class_name"]))


def _of_class(tracks: pa.Table, boxes: FloatArray, class_name: str) -> ClassTracks:
    wanted = ~np.isnan(boxes[:, 0]) & np.asarray(pc.equal(tracks["class_name"], class_name))
    return ClassTracks(
        frame_index=integers(tracks, "frame_index")[wanted],
        track_id=integers(tracks, "track_id")[wanted],
        boxes=boxes[wanted],
        track_score=np.asarray(tracks["track_score"])[wanted],
    )
