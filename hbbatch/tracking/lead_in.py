"""Where an object was before it was first detected: an offline processor can look back.

Most labelled boxes without a track are those of far objects that are detected a few frames later.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.tracks import SequenceTracks, TrackState

_FITTED_S: Final = 1.0
"""The detections of how long tell a track's first motion."""

_A_TICK_S: Final = 1e-6

_FEWEST_DETECTIONS: Final = 3
"""So many do, however long they take; fewer tell nothing of it."""


def add_lead_ins(tracks: SequenceTracks, timestamp_ns: IntArray, reach_s: float) -> SequenceTracks:
    """Tracks begin earlier: boxes before the first one, as if the motion had been uniform.

    The motion is that of the straight line through the detected boxes of a track's first second, or
    the first three; size and yaw are those of its first box.

    Args:
        tracks: without gaps.
        timestamp_ns: time of each frame.
        reach_s: how far to go back at most.
    """
    if not reach_s:
        return tracks
    time_s: FloatArray = ((timestamp_ns - timestamp_ns[:1]) * 1e-9).astype(np.float64)
    beginning = _beginnings(tracks, time_s)
    first_frame = tracks.frame_index[beginning.row]
    earliest = np.searchsorted(time_s, time_s[first_frame] - reach_s - _A_TICK_S)
    added = np.where(beginning.known, first_frame - earliest, 0)
    number = np.arange(added.sum()) - np.repeat(np.cumsum(added) - added, added)
    track = np.repeat(np.arange(len(added)), added)
    frame = earliest[track] + number
    rows = beginning.row[track]
    velocity = beginning.velocity_m_s[track]
    boxes = tracks.boxes[rows]
    boxes[:, :3] = (
        beginning.mean_m[track] + velocity * (time_s[frame] - beginning.mean_s[track])[:, None]
    )
    before = tracks.undetected(rows, frame, TrackState.EXTRAPOLATED, boxes)
    return tracks.joined(replace(before, velocity_m_s=velocity))


class _Beginnings(NamedTuple):
    """The first motion of each track.

    Attributes:
        row: of its first box.
        known: whether the detections tell it.
        mean_s: mean of their times.
        mean_m: `(tracks, 3)` mean of their centres.
        velocity_m_s: `(tracks, 3)` slope of the line through their centres.
    """

    row: IntArray
    known: NDArray[np.bool_]
    mean_s: FloatArray
    mean_m: FloatArray
    velocity_m_s: FloatArray


def _beginnings(tracks: SequenceTracks, time_s: FloatArray) -> _Beginnings:
    """Least squares, track by track."""
    order = np.lexsort((tracks.frame_index, tracks.track_id))
    order = order[tracks.detection_row[order] >= 0]
    time, centre = time_s[tracks.frame_index[order]], tracks.boxes[order, :3]
    (first,) = np.nonzero(np.diff(tracks.track_id[order], prepend=-1))
    rows = np.diff(first, append=len(order))
    track = np.repeat(np.arange(len(first)), rows)
    early = time - time[first][track] <= _FITTED_S + _A_TICK_S
    early |= np.arange(len(order)) - first[track] < _FEWEST_DETECTIONS
    track, time, centre = track[early], time[early], centre[early]
    count = np.bincount(track, minlength=len(first))
    mean_s = np.bincount(track, time, len(first)) / count
    mean_m = _sums(track, centre, len(first)) / count[:, None]
    offset_s = time - mean_s[track]
    spread = np.bincount(track, offset_s**2, len(first))
    slope = _sums(track, offset_s[:, None] * (centre - mean_m[track]), len(first))
    known = (count >= _FEWEST_DETECTIONS) & (spread > 0.0)
    return _Beginnings(
        order[first], known, mean_s, mean_m, slope / np.maximum(spread, 1e-12)[:, None]
    )


def _sums(group: IntArray, values: FloatArray, count: int) -> FloatArray:
    """Sums of the columns of `(n, 3)` by group, `(count, 3)`."""
    return np.stack([np.bincount(group, column, count) for column in values.T], axis=1)
