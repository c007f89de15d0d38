"""What speaks for a track and for each of its boxes: detection scores, averaged.

A detector's score of one frame is noisy; over a track it tells true from false, and over the
frames nearby it tells where a true track runs on without its object (occluded, or out of reach).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.tracks import SequenceTracks

NEARBY_S: Final = 0.3
"""Standard deviation of the window for local scores."""

_WIDEST_SHIFT: Final = 9
"""Frames to either side that a window takes in at most."""


class TrackEvidence(NamedTuple):
    """Evidence for each row's track, each `(n,)`.

    Attributes:
        score: mean score of its detections.
        detections: their number.
    """

    score: FloatArray
    detections: FloatArray


def evidence_of_track(tracks: SequenceTracks) -> TrackEvidence:
    """Evidence from the whole track."""
    _, index = np.unique(tracks.track_id, return_inverse=True)
    seen = tracks.detection_row >= 0
    size = index.max(initial=-1) + 1
    total = np.bincount(index[seen], tracks.score[seen], minlength=size)
    count = np.bincount(index[seen], minlength=size).astype(float)
    return TrackEvidence((total / np.maximum(count, 1))[index], count[index])


def evidence_so_far(tracks: SequenceTracks) -> TrackEvidence:
    """Evidence from the track's frames up to each row's own."""
    order = np.lexsort((tracks.frame_index, tracks.track_id))
    seen = (tracks.detection_row >= 0)[order]
    total = _running_sum(np.where(seen, tracks.score[order], 0.0), tracks.track_id[order])
    count = _running_sum(seen.astype(float), tracks.track_id[order])
    back = np.argsort(order)
    return TrackEvidence((total / np.maximum(count, 1))[back], count[back])


def local_score(tracks: SequenceTracks, timestamp_ns: IntArray) -> FloatArray:
    """Mean detection score of the track around each row, weighted by nearness in time, `(n,)`."""
    return _nearby_mean(tracks, timestamp_ns, _both_ways)


def local_score_so_far(tracks: SequenceTracks, timestamp_ns: IntArray) -> FloatArray:
    """The same from each row's own frame and those before it."""
    return _nearby_mean(tracks, timestamp_ns, _backwards)


class _Sums(NamedTuple):
    total: FloatArray
    weight: FloatArray


def _nearby_mean(
    tracks: SequenceTracks, timestamp_ns: IntArray, spread: Callable[..., None]
) -> FloatArray:
    order = np.lexsort((tracks.frame_index, tracks.track_id))
    track, score = tracks.track_id[order], tracks.score[order]
    time_s = timestamp_ns[tracks.frame_index[order]] * 1e-9
    known = ~np.isnan(score)
    score = np.where(known, score, 0.0)
    sums = _Sums(score.copy(), known.astype(float))
    for shift in range(1, min(_WIDEST_SHIFT + 1, len(order))):
        apart = (time_s[shift:] - time_s[:-shift]) / NEARBY_S
        weight = np.exp(-0.5 * apart**2) * (track[shift:] == track[:-shift])
        spread(sums, score, known, weight, shift)
    mean = np.empty(len(order))
    mean[order] = sums.total / np.maximum(sums.weight, 1e-12)
    return mean


def _backwards(
    sums: _Sums, score: FloatArray, known: FloatArray, weight: FloatArray, shift: int
) -> None:
    """Each row takes in the one `shift` rows before it."""
    sums.total[shift:] += weight * score[:-shift]
    sums.weight[shift:] += weight * known[:-shift]


def _both_ways(
    sums: _Sums, score: FloatArray, known: FloatArray, weight: FloatArray, shift: int
) -> None:
    """Each row takes in those `shift` rows before and after it."""
    _backwards(sums, score, known, weight, shift)
    sums.total[:-shift] += weight * score[shift:]
    sums.weight[:-shift] += weight * known[shift:]


def _running_sum(values: FloatArray, group: IntArray) -> FloatArray:
    """Sums so far within runs of equal group."""
    if not len(values):
        return values
    total = np.cumsum(values)
    first = np.flatnonzero(np.diff(group, prepend=group[0] - 1))
    before = np.repeat(total[first] - values[first], np.diff(first, append=len(values)))
    running: FloatArray = total - before
    return running
