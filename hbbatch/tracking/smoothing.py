"""Boxes settled by what came before and after them: an offline processor sees both.

Online, a filter has the past only. Here each centre and heading is moved to where the detections
nearby in time say that it was, and all boxes of a track get one size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import HEIGHT, LENGTH, YAW, FloatArray, wrap_angle
from hbbatch.model.kinds import KIND_OF_CLASS
from hbbatch.tracking.frames import IntArray, SequenceFrames
from hbbatch.tracking.local_fit import local_fit
from hbbatch.tracking.tracks import SequenceTracks

_SENSOR_REACH_S: Final = 0.5
"""In the sensor's frame, which errors of the ego pose leave alone, a shorter reach does best."""

_GAP_WEIGHT: Final = 0.1
"""Of what was interpolated, next to what was detected."""

_TYPICAL_RESIDUALS: Final = 2.0
"""Detections that are off by more than so many median residuals count less, as Huber's do."""

_LEAST_RANGE_M: Final = 3.0
_LEAST_RESIDUAL: Final = 1e-9


def settle_sizes(
    tracks: SequenceTracks, frames: SequenceFrames, class_names: Sequence[str]
) -> SequenceTracks:
    """Every box of a track gets the track's length, width and height: objects are rigid.

    They are the medians of the track's detections; of vehicles, whose far side is hidden, those of
    the nearer half of them.

    Args:
        tracks: each with a detection.
        frames: where they were found.
        class_names: of the tracks' class codes.
    """
    vehicle = np.array([KIND_OF_CLASS.get(name) == "vehicle" for name in class_names])
    detected = np.flatnonzero(tracks.detection_row >= 0)
    detection = tracks.detection_row[detected]
    owner, range_m = tracks.track_id[detected], _range_m(frames, detection)
    order = np.lexsort((range_m, owner))
    owner = owner[order]
    ids, first, count = np.unique(owner, return_index=True, return_counts=True)
    is_vehicle = vehicle[tracks.class_code[detected[order[first]]]]
    used = np.where(is_vehicle, (count + 1) // 2, count)
    nearer = np.arange(len(order)) - np.repeat(first, count) < np.repeat(used, count)
    of_track = np.searchsorted(ids, tracks.track_id)
    boxes = tracks.boxes.copy()
    for column in range(LENGTH, HEIGHT + 1):
        size = frames.boxes[detection[order[nearer]], column]
        boxes[:, column] = _medians(owner[nearer], size)[of_track]
    return replace(tracks, boxes=boxes)


def smoothed(tracks: SequenceTracks, frames: SequenceFrames, reach_s: float) -> SequenceTracks:
    """Centres and headings moved to where the detections nearby say they were.

    First in the world, where objects move evenly, by robust local regression; then, over a shorter
    time, in the sensor's frame, where errors of the ego pose cancel. Which way a box faces is not
    changed: headings are smoothed as of boxes without a front.

    Args:
        tracks: without gaps.
        frames: where they were found.
        reach_s: time to the farthest detection that has a say; 0 changes nothing.
    """
    if not (reach_s and len(tracks.track_id)):
        return tracks
    order = np.lexsort((tracks.frame_index, tracks.track_id))
    ordered = tracks.take(order)
    time_s = ((frames.timestamp_ns - frames.timestamp_ns[0]) * 1e-9)[ordered.frame_index]
    measured, seen = _measured(ordered, frames)
    fitted = _robust_fit(ordered, frames, time_s, _poles(measured), seen, reach_s)
    boxes = tracks.boxes.copy()
    boxes[order, :3] = _in_sensor_frame(ordered, frames, time_s, fitted[:, :3])
    heading = 0.5 * np.arctan2(fitted[:, 4], fitted[:, 3])
    faced = ordered.boxes[:, YAW]
    boxes[order, YAW] = wrap_angle(heading + np.pi * np.round((faced - heading) / np.pi))
    return replace(tracks, boxes=boxes)


def _measured(
    tracks: SequenceTracks, frames: SequenceFrames
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """The detected box of each row, its own where there is none; and which were detected."""
    seen = tracks.detection_row >= 0
    boxes = tracks.boxes.copy()
    boxes[seen] = frames.boxes[tracks.detection_row[seen]]
    return boxes, seen


def _poles(boxes: FloatArray) -> FloatArray:
    """`(n, 5)` centres, and headings as unit vectors of twice the angle, equal for both ends."""
    twice = 2.0 * boxes[:, YAW]
    return np.column_stack([boxes[:, :3], np.cos(twice), np.sin(twice)])


def _robust_fit(
    tracks: SequenceTracks,
    frames: SequenceFrames,
    time_s: FloatArray,
    values: FloatArray,
    seen: NDArray[np.bool_],
    reach_s: float,
) -> FloatArray:
    """Fitted twice: what is far from the first fit counts less in the second."""
    weights = np.where(seen, 1.0, _GAP_WEIGHT)
    first = local_fit(tracks.track_id, time_s, values, weights, reach_s)
    sight = values[:, :2] - frames.translation_m[tracks.frame_index, :2]
    range_m = np.maximum(np.hypot(sight[:, 0], sight[:, 1]), _LEAST_RANGE_M)
    off = np.maximum(
        _in_medians(np.linalg.norm((values - first)[:, :3], axis=1) / range_m, seen),
        _in_medians(np.linalg.norm((values - first)[:, 3:], axis=1), seen),
    )
    weights /= np.maximum(off / _TYPICAL_RESIDUALS, 1.0)
    return local_fit(tracks.track_id, time_s, values, weights, reach_s)


def _in_medians(residual: FloatArray, seen: NDArray[np.bool_]) -> FloatArray:
    """In units of the detections' median residual."""
    unit: FloatArray = residual / max(np.median(residual[seen]), _LEAST_RESIDUAL)
    return unit


def _in_sensor_frame(
    tracks: SequenceTracks, frames: SequenceFrames, time_s: FloatArray, centre_m: FloatArray
) -> FloatArray:
    """Centres `(n, 3)` smoothed as the sensor saw them, in the world again."""
    rotation = frames.rotation[tracks.frame_index]
    translation = frames.translation_m[tracks.frame_index]
    in_sensor = np.einsum("nji,nj->ni", rotation, centre_m - translation)
    even = np.ones(len(time_s))
    fitted = local_fit(tracks.track_id, time_s, in_sensor, even, _SENSOR_REACH_S)
    in_world: FloatArray = np.einsum("nij,nj->ni", rotation, fitted) + translation
    return in_world


def _range_m(frames: SequenceFrames, detection: IntArray) -> FloatArray:
    sight = frames.sight_m[detection, :2]
    range_m: FloatArray = np.hypot(sight[:, 0], sight[:, 1])
    return range_m


def _medians(owner: IntArray, values: FloatArray) -> FloatArray:
    """Of the values of each owner, `(owners,)`; owners lie one after the other."""
    ranked = values[np.lexsort((values, owner))]
    _, first, count = np.unique(owner, return_index=True, return_counts=True)
    medians: FloatArray = 0.5 * (ranked[first + (count - 1) // 2] + ranked[first + count // 2])
    return medians
