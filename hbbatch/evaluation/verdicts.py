"""Which boxes of tracks are right, box by box: what confidence is fitted to.

In the image where labels and a camera allow it, by the rules of KITTI's protocol (boxes in DontCare
regions, at most 25 pixels high, on vans or truncated objects are not judged); otherwise by the
overlap of volumes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from hbbatch import schema
from hbbatch.boxes import BOX_FIELDS, FloatArray
from hbbatch.evaluation.box_3d import box_truth, volume_iou
from hbbatch.evaluation.columns import floats, integers
from hbbatch.evaluation.kitti import KITTI_CLASSES, kitti_truth
from hbbatch.evaluation.metrics import ClassTruth, IntArray
from hbbatch.projection import Camera

RIGHT, WRONG, NOT_JUDGED = 1, 0, -1

Verdicts = NDArray[np.int8]
Overlap = Callable[[FloatArray, FloatArray], FloatArray]

_LEAST_IMAGE_IOU: Final = 0.5
_LEAST_VOLUME_IOU: Final = 0.3
_LEAST_HEIGHT_PX: Final = 25.0
_HIDDEN: Final = 2
"""Highest occlusion level of objects that have to be found."""


def verdicts(tracks: pa.Table, labels: pa.Table, camera: Camera | None, name: str) -> Verdicts:
    """`RIGHT`, `WRONG` or `NOT_JUDGED` for each row of tracks; only rows of the class are judged.

    Args:
        tracks: table of `schema.TRACKS`.
        labels: table of `schema.LABELS` of the same sequence.
        camera: of the sequence, if it has one.
        name: normalised class name.
    """
    boxes = floats(tracks, [f"sensor_{field}" for field in BOX_FIELDS])
    frame = integers(tracks, "frame_index")
    kind, names = schema.codes(tracks["class_name"])
    of_class = np.array([other == name for other in names], bool)[kind]
    found = np.full(len(frame), NOT_JUDGED, np.int8)
    if camera is not None and labels["image_left"].null_count < labels.num_rows:
        if name not in KITTI_CLASSES:
            return found
        truth = kitti_truth({"": labels}, [name])[name][""]
        image = camera.outlines(boxes, kind, names)
        of_class &= ~np.isnan(image[:, 0])
        found[of_class] = _in_image(frame[of_class], image[of_class], truth)
    else:
        truth = box_truth(labels, name)
        found[of_class] = _in_space(frame[of_class], boxes[of_class], truth)
    return found


def _in_image(frame: IntArray, boxes: FloatArray, truth: ClassTruth) -> Verdicts:
    matched = _matched(frame, boxes, truth, image_iou, _LEAST_IMAGE_IOU)
    ignored = boxes[:, 3] - boxes[:, 1] <= _LEAST_HEIGHT_PX
    for number in np.intersect1d(frame, truth.ignored_frame_index):
        rows = np.flatnonzero(frame == number)
        regions = truth.ignored_regions[truth.ignored_frame_index == number]
        shared = _shared_area(boxes[rows], regions) / _area(boxes[rows])[:, None]
        ignored[rows] |= (shared > _LEAST_IMAGE_IOU).any(axis=1)
    return _judged(matched, ignored, truth)


def _in_space(frame: IntArray, boxes: FloatArray, truth: ClassTruth) -> Verdicts:
    matched = _matched(frame, boxes, truth, volume_iou, _LEAST_VOLUME_IOU)
    return _judged(matched, np.zeros(len(frame), bool), truth)


def _judged(matched: IntArray, ignored: NDArray[np.bool_], truth: ClassTruth) -> Verdicts:
    found = np.where(matched >= 0, RIGHT, np.where(ignored, NOT_JUDGED, WRONG)).astype(np.int8)
    optional = truth.look_alike | (truth.occlusion > _HIDDEN) | (truth.truncation > 0)
    found[(matched >= 0) & np.append(optional, False)[matched]] = NOT_JUDGED
    return found


def _matched(
    frame: IntArray, boxes: FloatArray, truth: ClassTruth, overlap: Overlap, least: float
) -> IntArray:
    """The object that each box is matched to, -1 for none: the most overlap in every frame."""
    matched = np.full(len(frame), -1)
    for number in np.intersect1d(frame, truth.frame_index):
        rows = np.flatnonzero(frame == number)
        objects = np.flatnonzero(truth.frame_index == number)
        shared = overlap(boxes[rows], truth.boxes[objects])
        own, its = linear_sum_assignment(-np.where(shared >= least, shared, 0.0))
        near = shared[own, its] >= least
        matched[rows[own[near]]] = objects[its[near]]
    return matched


def image_iou(first: FloatArray, second: FloatArray) -> FloatArray:
    """Intersection over union of rectangles `(n, 4)` and `(m, 4)`, `(n, m)`."""
    shared = _shared_area(first, second)
    return shared / (_area(first)[:, None] + _area(second) - shared)


def _shared_area(first: FloatArray, second: FloatArray) -> FloatArray:
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(first[:, None, 2:], second[None, :, 2:])
    area: FloatArray = np.maximum(high - low, 0.0).prod(axis=2)
    return area


def _area(boxes: FloatArray) -> FloatArray:
    area: FloatArray = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    return area
