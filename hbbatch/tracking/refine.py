"""What an offline processor does after a sequence: fill gaps, settle boxes, choose them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import YAW, FloatArray, wrap_angle
from hbbatch.config import OutputSettings, ScoreCut
from hbbatch.tracking.confidence import confidence
from hbbatch.tracking.evidence import TrackScore, evidence_of, score_of_track, score_so_far
from hbbatch.tracking.frames import IntArray, SequenceFrames
from hbbatch.tracking.lead_in import add_lead_ins
from hbbatch.tracking.smoothing import settle_sizes, smoothed
from hbbatch.tracking.tracks import SequenceTracks, TrackedSequence, TrackState

NO_SCORE = -np.inf


def refine(
    tracks: SequenceTracks,
    frames: SequenceFrames,
    output: OutputSettings,
    class_names: Sequence[str],
) -> TrackedSequence:
    """The boxes to write, by the chosen protocol, and what speaks for them.

    Online, a box is judged by what was known of its track in its own frame.

    Args:
        tracks: all boxes of all tracks.
        frames: the sequence they were found in.
        output: protocol and cuts.
        class_names: of the tracks' class codes.
    """
    least = _least_by_class(output.min_track_score, class_names)[tracks.class_code]
    if output.protocol == "online":
        score = score_so_far(tracks)
        kept = _convincing(score, output.min_detections, least)
        return _likely(tracks, kept, score, frames, output, class_names)
    chosen = tracks.take(_convincing(score_of_track(tracks), output.min_detections, least))
    filled = fill_gaps(settle_sizes(chosen, frames, class_names), frames)
    filled = smoothed(filled, frames, output.smoothing_s)
    filled = add_lead_ins(filled, frames.timestamp_ns, output.lead_in_s)
    kept = np.ones(len(filled.track_id), bool)
    return _likely(filled, kept, score_of_track(filled), frames, output, class_names)


def _likely(
    tracks: SequenceTracks,
    kept: NDArray[np.bool_],
    score: TrackScore,
    frames: SequenceFrames,
    output: OutputSettings,
    class_names: Sequence[str],
) -> TrackedSequence:
    """Those of the kept boxes that are likely right, or detected and not judged."""
    if output.score_scale:
        known = evidence_of(output.protocol, tracks, frames)
        probability = confidence(known, tracks.class_code, output, class_names)
    else:  # nothing can be judged
        probability = np.full(len(tracks.track_id), np.nan)
    kept = kept & likely(tracks, probability, output.min_confidence)
    return TrackedSequence(frames, tracks.take(kept), score.track_score[kept], probability[kept])


def likely(tracks: SequenceTracks, probability: FloatArray, least: float) -> NDArray[np.bool_]:
    """Which boxes to write, `(n,)`: those at least as likely right as asked.

    What was not judged is written, except predictions that nothing confirms: most are wrong.
    """
    predicted = (tracks.state == TrackState.COASTED) | (tracks.state == TrackState.EXTRAPOLATED)
    unknown = np.isnan(probability)
    return np.where(unknown, ~predicted | (least <= 0.0), probability >= least)


def _convincing(
    known: TrackScore, min_detections: int, least_score: FloatArray
) -> NDArray[np.bool_]:
    return (known.detections >= min_detections) & (known.track_score >= least_score)


def _least_by_class(cut: ScoreCut, class_names: Sequence[str]) -> FloatArray:
    """Lowest score to write, by class code."""
    if isinstance(cut, dict):
        return np.array([cut.get(name, NO_SCORE) for name in class_names])
    return np.full(len(class_names), NO_SCORE if cut is None else cut)


def fill_gaps(tracks: SequenceTracks, frames: SequenceFrames) -> SequenceTracks:
    """Frames a track skipped between two detections get a box interpolated in time."""
    order = np.lexsort((tracks.frame_index, tracks.track_id))
    frame, track = tracks.frame_index[order], tracks.track_id[order]
    missing = np.where(np.diff(track) == 0, np.diff(frame) - 1, 0)
    before = np.repeat(order[:-1], missing)
    after = np.repeat(order[1:], missing)
    number = np.arange(len(before)) - np.repeat(np.cumsum(missing) - missing, missing)
    index = tracks.frame_index[before] + number + 1
    weight = _time_share(frames.timestamp_ns, tracks.frame_index, before, after, index)
    boxes = _interpolate_boxes(tracks.boxes[before], tracks.boxes[after], weight)
    velocity = (1 - weight) * tracks.velocity_m_s[before] + weight * tracks.velocity_m_s[after]
    between = tracks.undetected(before, index, TrackState.INTERPOLATED, boxes)
    return tracks.joined(replace(between, velocity_m_s=velocity))


def _time_share(
    timestamp_ns: IntArray, frame: IntArray, before: IntArray, after: IntArray, index: IntArray
) -> FloatArray:
    """How far in time each frame lies between two others, `(n, 1)`."""
    start, end = timestamp_ns[frame[before]], timestamp_ns[frame[after]]
    share: FloatArray = ((timestamp_ns[index] - start) / np.maximum(end - start, 1))[:, None]
    return share


def _interpolate_boxes(first: FloatArray, second: FloatArray, weight: FloatArray) -> FloatArray:
    boxes = (1 - weight) * first + weight * second
    turn = wrap_angle(second[:, YAW] - first[:, YAW])
    boxes[:, YAW] = wrap_angle(first[:, YAW] + weight[:, 0] * turn)
    return boxes
