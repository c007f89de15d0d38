"""Collects what each step says about each track, and hands it out sequence by sequence.

What is said of a detection has its place beforehand, for each is said once, of the track that it
continued or began: places are the detections' numbers in the group, sequence after sequence
(`Schedule.place`). What is said without one, of tracks that coast, gets places after them. Boxes
and velocities are remembered by who steps the filter, where they are.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.schedule import Schedule
from hbbatch.tracking.tracks import SequenceTracks, TrackState

Said = tuple[FloatArray, FloatArray]
"""Boxes `(n, 7)` and velocities in m/s `(n, 3)`, world frame."""

_Scalar = TypeVar("_Scalar", bound=np.generic)


def with_room(rows: NDArray[_Scalar], count: int) -> NDArray[_Scalar]:
    """The same rows if there are so many, else a copy with room for them and as many again."""
    if count <= len(rows):
        return rows
    larger = np.empty((2 * count, *rows.shape[1:]), rows.dtype)
    larger[: len(rows)] = rows
    return larger


class Recorder:
    """Tracks and steps by place.

    A track is known by the place of the detection it was born from, and numbered when its sequence
    is finished.

    Attributes:
        first: who the track of each place is.
        step: of each place.
        places: how many are used.
    """

    def __init__(self, plan: Schedule) -> None:
        """Nothing recorded yet."""
        self._plan = plan
        self._seen = self._dealt = self.places = len(plan.place)
        self._scores = self._by_place(plan.scores)
        self._class_codes = self._by_place(plan.class_codes)
        self.first = np.empty(self._seen, np.int64)
        self.step = self._by_place(plan.step_of_each())
        self._coasted: list[list[IntArray]] = [[] for _ in plan.first_step]

    def _by_place(self, column: NDArray[_Scalar]) -> NDArray[_Scalar]:
        placed = np.empty_like(column)
        placed[self._plan.place] = column
        return placed

    def reserve(self, places: int) -> None:
        """Have so many places, those of the group's detections counted."""
        self.first, self.step = with_room(self.first, places), with_room(self.step, places)

    def _detections(self, sequence: int) -> IntArray:
        return np.arange(self._plan.first_place[sequence], self._plan.first_place[sequence + 1])

    def places_of(self, sequence: int) -> IntArray:
        """Places of a finished sequence, sorted by frame and track."""
        self._deal()
        places = np.concatenate([self._detections(sequence), *self._coasted[sequence]])
        key = self.step.take(places) * self._seen + self.first.take(places)
        return places.take(key.argsort(kind="stable"))

    def _deal(self) -> None:
        """Let each sequence have the places of its coasting tracks that came meanwhile."""
        places = np.arange(self._dealt, self.places)
        self._dealt = self.places
        if not len(places):
            return
        sequence = self._plan.first_place.searchsorted(self.first[places], side="right") - 1
        order = sequence.argsort(kind="stable")
        numbers, starts = np.unique(sequence[order], return_index=True)
        for number, part in zip(numbers, np.split(places[order], starts[1:]), strict=True):
            self._coasted[number].append(part)

    def tracks(self, sequence: int, places: IntArray, said: Said) -> SequenceTracks:
        """All boxes of a finished sequence, given what was said in its places."""
        detections = self._detections(sequence)
        born = detections[self.first.take(detections) == detections]
        first = self.first.take(places)
        seen = places < self._seen
        detection = np.where(seen, places, -1)
        boxes, velocity_m_s = said
        return SequenceTracks(
            frame_index=self.step.take(places) - self._plan.first_step[sequence],
            track_id=born.searchsorted(first) + 1,
            class_code=self._class_codes.take(first),
            state=np.where(seen, TrackState.DETECTED, TrackState.COASTED).astype(np.int8),
            score=np.where(seen, self._scores[detection], np.nan),
            boxes=boxes,
            velocity_m_s=velocity_m_s,
            detection_row=np.where(seen, places - self._plan.first_place[sequence], -1),
        )
