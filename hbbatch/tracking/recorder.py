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

_SEQUENCE, _TRACK_ID, _CLASS_CODE, _STEP = range(4)


class Recorder:
    """Identities and steps by place; boxes are collected by the bank, where they are."""

    def __init__(self, plan: Schedule, bank: FilterBank) -> None:
        """Nothing recorded yet."""
        self._plan = plan
        self._bank = bank
        self._said = np.empty((len(plan.scores), 4), np.int64)
        self._said[:, _SEQUENCE] = plan.sequence
        self._said[:, _STEP] = np.repeat(np.arange(plan.steps), np.diff(plan.offsets))
        sequences = len(plan.first_step)
        counts = np.bincount(plan.sequence, minlength=sequences)
        order = plan.sequence.argsort(kind="stable")
        self._detections = np.split(order, np.cumsum(counts)[:-1])
        self._places = len(plan.scores)
        self._coasted: list[list[IntArray]] = [[] for _ in range(sequences)]

    def add(self, identities: IntArray, detections: IntArray, rows: slice) -> None:
        """Record what is said of detections. Nothing is synchronised here.

        Args:
            identities: `(3, k)` sequence, track id and class code.
            detections: `(k,)` of the group.
            rows: of their tracks.
        """
        self._said[detections, _TRACK_ID : _CLASS_CODE + 1] = identities[1:].T
        self._bank.say(rows, detections)

    def add_coasted(self, step: int, identities: IntArray, rows: IntArray) -> None:
        """Record what a step says of rows without a detection."""
        if not len(rows):
            return
        first, self._places = self._places, self._places + len(rows)
        self._said = with_room(self._said, self._places)
        places = np.arange(first, self._places)
        self._said[places, :_STEP], self._said[places, _STEP] = identities.T, step
        self._bank.say(rows, places)
        order = identities[0].argsort(kind="stable")
        numbers, starts = np.unique(identities[0][order], return_index=True)
        for number, part in zip(numbers, np.split(places[order], starts[1:]), strict=True):
            self._coasted[number].append(part)

    def finish(self, sequence: int) -> SequenceTracks:
        """All boxes of a finished sequence, sorted by frame and track."""
        places = np.concatenate([self._detections[sequence], *self._coasted[sequence]])
        said = self._said[places]
        order = np.lexsort((said[:, _TRACK_ID], said[:, _STEP]))
        place, (_, track_id, class_code, step) = places[order], said[order].T
        seen = place < len(self._plan.scores)
        detection = np.where(seen, place, -1)
        boxes, velocity_m_s = self._bank.said(place)
        return SequenceTracks(
            frame_index=step - self._plan.first_step[sequence],
            track_id=track_id,
            class_code=class_code,
            state=np.where(seen, TrackState.DETECTED, TrackState.COASTED).astype(np.int8),
            score=np.where(seen, self._plan.scores[detection], np.nan),
            boxes=boxes,
            velocity_m_s=velocity_m_s,
            detection_row=np.where(seen, self._plan.row[detection], -1),
        )
