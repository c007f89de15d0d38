"""Collects what each step says about each track, and hands it out sequence by sequence.

What is said of a detection has its place beforehand: the detection's number in the group, for each
is said once, of the track that it continued or began. What is said without one, of tracks that
coast, gets places after them.
"""

from __future__ import annotations

import numpy as np

from hbbatch.tracking.bank import FilterBank, with_room
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.schedule import Schedule
from hbbatch.tracking.tracks import SequenceTracks, TrackState


class Recorder:
    """Tracks and steps by place; boxes are collected by the bank, where they are.

    A track is known by the detection it was born from, and numbered when its sequence is finished.
    """

    def __init__(self, plan: Schedule, bank: FilterBank) -> None:
        """Nothing recorded yet."""
        self._plan = plan
        self._bank = bank
        self._first = np.empty(len(plan.scores), np.int64)
        self._step = np.repeat(np.arange(plan.steps), np.diff(plan.offsets))
        self._places = len(plan.scores)
        sequences = len(plan.first_step)
        counts = np.bincount(plan.sequence, minlength=sequences)
        order = plan.sequence.argsort(kind="stable")
        self._detections = np.split(order, np.cumsum(counts)[:-1])
        self._coasted: list[list[IntArray]] = [[] for _ in range(sequences)]

    def add(self, first: IntArray, detections: IntArray, rows: IntArray) -> None:
        """Record what is said of detections. Nothing is synchronised here.

        Args:
            first: `(k,)` detection that each track was born from.
            detections: `(k,)` of the group.
            rows: `(k,)` of the tracks.
        """
        self._first[detections] = first
        self._bank.say(rows, detections)

    def add_coasted(self, step: int, first: IntArray, rows: IntArray) -> None:
        """Record what a step says of rows without a detection."""
        if not len(rows):
            return
        start, self._places = self._places, self._places + len(rows)
        self._first = with_room(self._first, self._places)
        self._step = with_room(self._step, self._places)
        places = np.arange(start, self._places)
        self._first[places], self._step[places] = first, step
        self._bank.reserve(self._places)
        self._bank.say(rows, places)
        sequence = self._plan.sequence[first]
        order = sequence.argsort(kind="stable")
        numbers, starts = np.unique(sequence[order], return_index=True)
        for number, part in zip(numbers, np.split(places[order], starts[1:]), strict=True):
            self._coasted[number].append(part)

    def finish(self, sequence: int) -> SequenceTracks:
        """All boxes of a finished sequence, sorted by frame and track."""
        plan, detections = self._plan, self._detections[sequence]
        born = detections[self._first.take(detections) == detections]
        places = np.concatenate([detections, *self._coasted[sequence]])
        first, step = self._first.take(places), self._step.take(places)
        order = (step * len(plan.scores) + first).argsort(kind="stable")
        places, first, step = places.take(order), first.take(order), step.take(order)
        seen = places < len(plan.scores)
        detection = np.where(seen, places, -1)
        boxes, velocity_m_s = self._bank.said(places)
        return SequenceTracks(
            frame_index=step - plan.first_step[sequence],
            track_id=born.searchsorted(first) + 1,
            class_code=plan.class_codes[first],
            state=np.where(seen, TrackState.DETECTED, TrackState.COASTED).astype(np.int8),
            score=np.where(seen, plan.scores[detection], np.nan),
            boxes=boxes,
            velocity_m_s=velocity_m_s,
            detection_row=np.where(seen, plan.row[detection], -1),
        )
