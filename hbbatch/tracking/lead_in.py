"""Where an object was before it was first detected: an offline processor can look back.

Most labelled boxes without a track are those of far objects that are detected a few frames later.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.tracks import SequenceTracks, TrackState

_FITTED_S: Final = 1.0
"""How much of a track's beginning its first motion is read from."""

_FEWEST_BOXES: Final = 3
"""Boxes in that time below which nothing is known of the motion."""


def add_lead_ins(tracks: SequenceTracks, timestamp_ns: IntArray, reach_s: float) -> SequenceTracks:
    """Tracks begin earlier: boxes before the first one, as if the motion had been uniform.

    The motion is that of the straight line through the positions of a track's first second; size
    and yaw are those of its first box.

    Args:
        tracks: without gaps.
        timestamp_ns: time of each frame.
        reach_s: how far to go back at most.
    """
    order = np.lexsort((tracks.frame_index, tracks.track_id))
    time_s: FloatArray = ((timestamp_ns - timestamp_ns[:1]) * 1e-9).astype(np.float64)
    beginning = _beginnings(tracks, order, time_s)
    first_frame = tracks.frame_index[beginning.row]
    earliest = np.searchsorted(time_s, time_s[first_frame] - reach_s - 1e-6)
    added = np.where(beginning.boxes >= _FEWEST_BOXES, first_frame - earliest, 0)
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
    """The first second of each track.

    Attributes:
        row: of its first box.
        boxes: how many it has.
        mean_s: mean of their times.
        mean_m: `(tracks, 3)` mean of their centres.
        velocity_m_s: `(tracks, 3)` slope of the line through their centres.
    """

    row: IntArray
    boxes: IntArray
    mean_s: FloatArray
    mean_m: FloatArray
    velocity_m_s: FloatArray


def _beginnings(tracks: SequenceTracks, order: IntArray, time_s: FloatArray) -> _Beginnings:
    """Least squares, track by track; `order` sorts by track, then frame."""
    time, centre = time_s[tracks.frame_index[order]], tracks.boxes[order, :3]
    (first,) = np.nonzero(np.diff(tracks.track_id[order], prepend=-1))
    track = np.repeat(np.arange(len(first)), np.diff(first, append=len(order)))
    early = time - time[first][track] <= _FITTED_S
    track, time, centre = track[early], time[early], centre[early]
    count = np.bincount(track, minlength=len(first))
    mean_s = np.bincount(track, time, len(first)) / count
    mean_m = _sums(track, centre, len(first)) / count[:, None]
    offset_s = time - mean_s[track]
    spread = np.bincount(track, offset_s**2, len(first))
    slope = _sums(track, offset_s[:, None] * (centre - mean_m[track]), len(first))
    return _Beginnings(
        order[first], count, mean_s, mean_m, slope / np.maximum(spread, 1e-12)[:, None]
    )


def _sums(group: IntArray, values: FloatArray, count: int) -> FloatArray:
    """Sums of the columns of `(n, 3)` by group, `(count, 3)`."""
    return np.stack([np.bincount(group, column, count) for column in values.T], axis=1)
