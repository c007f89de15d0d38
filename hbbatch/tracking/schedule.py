"""Which sequence steps when: a group's frames laid out in lock step before the first step.

Frame counts are known beforehand, so the whole timetable is too: sequences are dealt to lanes,
longest first, each lane running its sequences one after the other. Detections are then sorted by
step, and a step's detections are one slice.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.tracking.frames import IntArray, SequenceFrames
from hbbatch.tracking.lanes import lane_count

DEFAULT_DT_S = 0.1
"""Step assumed where a sequence's clock does not advance."""


@dataclass(frozen=True)
class Schedule:
    """Timetable of a group.

    Attributes:
        first_step: `(sequences,)` step at which each sequence's frame 0 is processed.
        first_frame: `(sequences,)` number of each sequence's frame 0 among all of the group.
        dt_s: `(frames,)` float32 time since the previous frame, sequence after sequence; the
            first one of a sequence is not used.
        offsets: `(steps + 1,)` first detection of each step.
        sequence: `(n,)` sequence number of each detection, detections sorted by step.
        place: `(n,)` number of each detection among all of the group, sequence after sequence.
        first_place: `(sequences + 1,)` that of each sequence's first detection.
        boxes, sight_m, scores, class_codes: the detections' columns in that order.
        ending: for each step, the sequences whose last frame it is.
        empty: sequences without frames.
    """

    first_step: IntArray
    first_frame: IntArray
    dt_s: NDArray[np.float32]
    offsets: IntArray
    sequence: IntArray
    place: IntArray
    first_place: IntArray
    boxes: FloatArray
    sight_m: FloatArray
    scores: FloatArray
    class_codes: IntArray
    ending: list[list[int]]
    empty: list[int]

    @property
    def steps(self) -> int:
        """Number of lock steps."""
        return len(self.offsets) - 1

    def step_of_each(self) -> IntArray:
        """`(n,)` step of each detection."""
        return np.arange(self.steps).repeat(np.diff(self.offsets))


def schedule(group: Sequence[SequenceFrames], lanes: int | None = None) -> Schedule:
    """The timetable of a group over at most `lanes` sequences at a time.

    By default their number is chosen by `lane_count`.
    """
    frame_counts = [frames.frame_count for frames in group]
    counts = [len(frames.scores) for frames in group]
    lanes = lane_count(sum(frame_counts), sum(counts)) if lanes is None else lanes
    first_step = _first_steps(frame_counts, lanes)
    last_step = [
        int(first) + frames.frame_count - 1 for first, frames in zip(first_step, group, strict=True)
    ]
    steps = max(last_step, default=-1) + 1
    ending: list[list[int]] = [[] for _ in range(steps)]
    for number, step in enumerate(last_step):
        if group[number].frame_count:
            ending[step].append(number)
    step_of = np.concatenate(
        [
            first + np.repeat(np.arange(frames.frame_count), np.diff(frames.offsets))
            for first, frames in zip(first_step, group, strict=True)
        ]
    )
    sequence = np.repeat(np.arange(len(group)), counts)
    order = np.argsort(step_of, kind="stable")
    return Schedule(
        first_step=first_step,
        first_frame=np.cumsum(frame_counts, dtype=np.int64) - frame_counts,
        dt_s=np.concatenate([intervals(frames) for frames in group]).astype(np.float32),
        offsets=np.searchsorted(step_of[order], np.arange(steps + 1)),
        sequence=sequence[order],
        place=order,
        first_place=np.cumsum([0, *counts]),
        boxes=np.concatenate([frames.boxes for frames in group]).take(order, axis=0),
        sight_m=np.concatenate([frames.sight_m for frames in group]).take(order, axis=0),
        scores=np.concatenate([frames.scores for frames in group])[order],
        class_codes=np.concatenate([frames.class_codes for frames in group])[order],
        ending=ending,
        empty=[number for number, frames in enumerate(group) if not frames.frame_count],
    )


def _first_steps(frame_counts: list[int], lanes: int) -> IntArray:
    """Longest first, each sequence to the lane that is free earliest."""
    free = [0] * max(1, min(lanes, len(frame_counts)))
    first = np.zeros(len(frame_counts), np.int64)
    for number in sorted(range(len(frame_counts)), key=lambda n: -frame_counts[n]):
        start = heapq.heappop(free)
        first[number] = start
        heapq.heappush(free, start + frame_counts[number])
    return first


def intervals(frames: SequenceFrames) -> FloatArray:
    """Seconds since the previous frame; where the clock stands still, a default step."""
    dt = np.diff(frames.timestamp_ns, prepend=frames.timestamp_ns[:1]) * 1e-9
    intervals: FloatArray = np.where(dt > 0, dt, DEFAULT_DT_S)
    return intervals
