"""What the tracker gives back: the tracks of one sequence as columns, and as the tracks table."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from hbbatch import schema
from hbbatch.boxes import BOX_FIELDS, FloatArray, transform_boxes
from hbbatch.tracking.frames import IntArray, SequenceFrames


class TrackState(IntEnum):
    """How a box of a track came about."""

    DETECTED = 0
    COASTED = 1
    INTERPOLATED = 2
    EXTRAPOLATED = 3


STATE_NAMES: Final = ("detected", "coasted", "interpolated", "extrapolated")


@dataclass(frozen=True)
class SequenceTracks:
    """Boxes of all tracks of one sequence, one row a track and frame, sorted by frame then track.

    Attributes:
        frame_index: `(n,)`.
        track_id: `(n,)` from 1.
        class_code: `(n,)` index into the tracker's class names.
        state: `(n,)` a `TrackState`.
        score: `(n,)` of the matched detection, NaN where there is none.
        boxes: `(n, 7)` world frame.
        velocity_m_s: `(n, 3)` world frame.
        detection_row: `(n,)` row in `SequenceFrames`, -1 where there is none.
    """

    frame_index: IntArray
    track_id: IntArray
    class_code: IntArray
    state: NDArray[np.int8]
    score: FloatArray
    boxes: FloatArray
    velocity_m_s: FloatArray
    detection_row: IntArray

    @property
    def track_count(self) -> int:
        """Distinct tracks."""
        return len(np.unique(self.track_id))

    @classmethod
    def empty(cls) -> SequenceTracks:
        """No boxes."""
        whole, real = np.empty(0, np.int64), np.empty(0)
        return cls(
            whole,
            whole,
            whole,
            np.empty(0, np.int8),
            real,
            np.empty((0, 7)),
            np.empty((0, 3)),
            whole,
        )

    def take(self, rows: NDArray[np.generic]) -> SequenceTracks:
        """Rows chosen by a mask or by index."""
        return SequenceTracks(**{name: column[rows] for name, column in vars(self).items()})

    def undetected(
        self, rows: IntArray, frame_index: IntArray, state: TrackState, boxes: FloatArray
    ) -> SequenceTracks:
        """Boxes for which nothing was detected, of the tracks of given rows, in other frames."""
        return replace(
            self.take(rows),
            frame_index=frame_index,
            state=np.full(len(rows), state, np.int8),
            score=np.full(len(rows), np.nan),
            boxes=boxes,
            detection_row=np.full(len(rows), -1),
        )

    def joined(self, other: SequenceTracks) -> SequenceTracks:
        """The rows of both, sorted."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        both = SequenceTracks(*(np.concatenate(pair) for pair in pairs))
        return both.take(np.lexsort((both.track_id, both.frame_index)))


@dataclass
class StageSeconds:
    """Seconds spent in each stage of lock-step tracking."""

    predict: float = 0.0
    associate: float = 0.0
    update: float = 0.0
    manage: float = 0.0

    @classmethod
    def total(cls, parts: Iterable[StageSeconds]) -> StageSeconds:
        """The sum of each stage, over one part at least."""
        columns = zip(*(vars(part).values() for part in parts), strict=True)
        return cls(*(sum(column) for column in columns))


class Evidence(NamedTuple):
    """What speaks for each row of tracks, each `(n,)`; online from the rows so far.

    Attributes:
        detection_score: of the row's own detection, NaN without one.
        nearby_score: mean of the track's scores, weighted by nearness in time; `track_score` where
            none is near.
        track_score: mean of the track's scores.
        presence: share of the frames nearby in which the track has a detection.
        detections: number of the track's detections.
        range_m: distance from the sensor, seen from above.
        unseen_s: time to the track's nearest detection (online: since its last), 0 with one.
    """

    detection_score: FloatArray
    nearby_score: FloatArray
    track_score: FloatArray
    presence: FloatArray
    detections: FloatArray
    range_m: FloatArray
    unseen_s: FloatArray

    @property
    def detected(self) -> NDArray[np.bool_]:
        """Which rows have a detection, `(n,)`."""
        return ~np.isnan(self.detection_score)

    def take(self, rows: NDArray[np.generic]) -> Evidence:
        """Rows chosen by a mask or by index."""
        return Evidence(*(column[rows] for column in self))


@dataclass(frozen=True)
class TrackedSequence:
    """A finished sequence with the share of the group's time that was its own.

    Attributes:
        frames: what was given.
        tracks: the boxes to write.
        track_score: `(n,)` mean score of each box's track, online of its rows so far.
        confidence: `(n,)` probability of each box to be right, NaN where it was not judged.
        seconds: time spent on it in each stage.
    """

    frames: SequenceFrames
    tracks: SequenceTracks
    track_score: FloatArray
    confidence: FloatArray
    seconds: StageSeconds = field(default_factory=StageSeconds)


def tracks_table(done: TrackedSequence, class_names: Sequence[str]) -> pa.Table:
    """The tracks as a table of `schema.TRACKS`, texts coded, with boxes in both frames."""
    tracks, frames = done.tracks, done.frames
    frame = tracks.frame_index
    sensor_from_world = frames.rotation[frame].transpose(0, 2, 1)
    offset = -np.einsum("nij,nj->ni", sensor_from_world, frames.translation_m[frame])
    sensor_boxes = transform_boxes(tracks.boxes, sensor_from_world, offset)
    matched = tracks.detection_row >= 0
    detection_id = np.zeros(len(frame), np.int64)
    detection_id[matched] = frames.detection_ids[tracks.detection_row[matched]]
    columns: dict[str, pa.Array] = {
        "frame_index": pa.array(frame.astype(np.int32)),
        "timestamp_ns": pa.array(frames.timestamp_ns[frame]),
        "track_id": pa.array(tracks.track_id),
        "class_name": _coded(tracks.class_code, class_names),
        "state": _coded(tracks.state, STATE_NAMES),
        "score": pa.array(tracks.score, mask=np.isnan(tracks.score)),
        "track_score": pa.array(done.track_score),
        "confidence": pa.array(done.confidence, mask=np.isnan(done.confidence)),
        **{name: pa.array(tracks.boxes[:, i]) for i, name in enumerate(BOX_FIELDS)},
        **{f"sensor_{name}": pa.array(sensor_boxes[:, i]) for i, name in enumerate(BOX_FIELDS)},
        **{f"velocity_{a}": pa.array(tracks.velocity_m_s[:, i]) for i, a in enumerate("xyz")},
        "detection_id": pa.array(detection_id, mask=~matched),
    }
    coded = schema.coded(schema.TRACKS)
    return schema.conform(pa.table(columns), coded, f"tracks of {frames.sequence_id}")


def _coded(codes: NDArray[np.integer], names: Sequence[str]) -> pa.DictionaryArray:
    return pa.DictionaryArray.from_arrays(codes.astype(np.int32), pa.array(names, pa.string()))
