"""What speaks for each box of a track: detection scores averaged, detections nearby, range.

A detector's score of one frame is noisy; over a track it tells true from false, and over the
frames nearby, with how many of them hold a detection, it tells where a true track runs on without
its object (occluded, or out of reach).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.config import ProtocolName
from hbbatch.tracking.frames import IntArray, SequenceFrames
from hbbatch.tracking.tracks import Evidence, SequenceTracks

NEARBY_S: Final = 0.3
"""Standard deviation of the window for scores nearby."""

PRESENCE_S: Final = 0.5
"""Standard deviation of the window in which detections are counted."""

_REACH: Final = 3.0
"""Standard deviations at which a window ends."""


class TrackScore(NamedTuple):
    """Of each row's track, each `(n,)`: the mean score of its detections, and their number."""

    track_score: FloatArray
    detections: FloatArray


def score_of_track(tracks: SequenceTracks) -> TrackScore:
    """From the whole track."""
    _, index = np.unique(tracks.track_id, return_inverse=True)
    seen = tracks.detection_row >= 0
    size = index.max(initial=-1) + 1
    total = np.bincount(index[seen], tracks.score[seen], minlength=size)
    count = np.bincount(index[seen], minlength=size).astype(float)
    return TrackScore((total / np.maximum(count, 1))[index], count[index])


def score_so_far(tracks: SequenceTracks) -> TrackScore:
    """From the track's frames up to each row's own."""
    order = np.lexsort((tracks.frame_index, tracks.track_id))
    seen = (tracks.detection_row >= 0)[order]
    total = _running_sum(np.where(seen, tracks.score[order], 0.0), tracks.track_id[order])
    count = _running_sum(seen.astype(float), tracks.track_id[order])
    back = np.argsort(order)
    return TrackScore((total / np.maximum(count, 1))[back], count[back])


def evidence_of(protocol: ProtocolName, tracks: SequenceTracks, frames: SequenceFrames) -> Evidence:
    """What a protocol knows of each row."""
    known = evidence_so_far if protocol == "online" else evidence
    return known(tracks, frames)


def evidence(tracks: SequenceTracks, frames: SequenceFrames) -> Evidence:
    """Evidence for each row from all of its track."""
    return _evidence(tracks, frames, score_of_track(tracks), _both_ways, _nearest_s)


def evidence_so_far(tracks: SequenceTracks, frames: SequenceFrames) -> Evidence:
    """Evidence for each row from its track's rows up to its own frame."""
    return _evidence(tracks, frames, score_so_far(tracks), _backwards, _since_s)


def _evidence(
    tracks: SequenceTracks,
    frames: SequenceFrames,
    track: TrackScore,
    spread: _Spread,
    unseen: _Unseen,
) -> Evidence:
    order = np.lexsort((tracks.frame_index, tracks.track_id))
    back = np.argsort(order)
    time_s = ((frames.timestamp_ns - frames.timestamp_ns[:1]) * 1e-9).astype(np.float64)
    rows = _Rows(time_s[tracks.frame_index[order]], tracks.track_id[order])
    seen = (tracks.detection_row >= 0)[order]
    score = np.where(seen, tracks.score[order], 0.0)
    weight = _window_sum(seen.astype(float), rows, NEARBY_S, spread)
    total = _window_sum(score, rows, NEARBY_S, spread)
    nearby = np.where(weight > 0.0, total / np.maximum(weight, 1e-12), track.track_score[order])
    detections = _window_sum(seen.astype(float), rows, PRESENCE_S, spread)[back]
    one_object = _Rows(time_s, np.zeros(len(time_s)))
    all_frames = _window_sum(np.ones(len(time_s)), one_object, PRESENCE_S, spread)
    offset = tracks.boxes[:, :2] - frames.translation_m[tracks.frame_index, :2]
    return Evidence(
        detection_score=np.where(seen, score, np.nan)[back],
        nearby_score=nearby[back],
        track_score=track.track_score,
        presence=detections / all_frames[tracks.frame_index],
        detections=track.detections,
        range_m=np.hypot(offset[:, 0], offset[:, 1]),
        unseen_s=unseen(rows, seen)[back],
    )


class _Rows(NamedTuple):
    """Times and owners of rows, sorted by owner, then time."""

    time_s: FloatArray
    owner: NDArray[Any]


_Spread = Callable[[FloatArray, FloatArray, FloatArray, int], None]


def _window_sum(values: FloatArray, rows: _Rows, width_s: float, spread: _Spread) -> FloatArray:
    """Sum over the rows of the same owner, weighted by nearness in time."""
    total = values.copy()
    for shift in range(1, len(values)):
        apart = (rows.time_s[shift:] - rows.time_s[:-shift]) / width_s
        near = (rows.owner[shift:] == rows.owner[:-shift]) & (apart <= _REACH)
        if not near.any():
            break
        spread(total, values, np.exp(-0.5 * apart**2) * near, shift)
    return total


def _backwards(total: FloatArray, values: FloatArray, weight: FloatArray, shift: int) -> None:
    """Each row takes in the one `shift` rows before it."""
    total[shift:] += weight * values[:-shift]


def _both_ways(total: FloatArray, values: FloatArray, weight: FloatArray, shift: int) -> None:
    """Each row takes in those `shift` rows before and after it."""
    _backwards(total, values, weight, shift)
    total[:-shift] += weight * values[shift:]


_Unseen = Callable[[_Rows, NDArray[np.bool_]], FloatArray]


def _since_s(rows: _Rows, seen: NDArray[np.bool_]) -> FloatArray:
    """Time since the owner's last row with a detection; infinite before its first."""
    last = np.maximum.accumulate(np.where(seen, np.arange(len(seen)), 0))
    known = seen[last] & (rows.owner[last] == rows.owner)
    return np.where(known, np.abs(rows.time_s - rows.time_s[last]), np.inf)


def _nearest_s(rows: _Rows, seen: NDArray[np.bool_]) -> FloatArray:
    """Time to the owner's nearest row with a detection."""
    backwards = _Rows(rows.time_s[::-1], rows.owner[::-1])
    nearest: FloatArray = np.minimum(_since_s(rows, seen), _since_s(backwards, seen[::-1])[::-1])
    return nearest


def _running_sum(values: FloatArray, group: IntArray) -> FloatArray:
    """Sums so far within runs of equal group."""
    if not len(values):
        return values
    total = np.cumsum(values)
    first = np.flatnonzero(np.diff(group, prepend=group[0] - 1))
    before = np.repeat(total[first] - values[first], np.diff(first, append=len(values)))
    running: FloatArray = total - before
    return running
