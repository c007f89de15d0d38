"""Collects what each step says about each track, and hands it out sequence by sequence."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hbbatch.tracking.bank import FilterBank
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.schedule import Schedule
from hbbatch.tracking.tracks import SequenceTracks, TrackState


class _Said(NamedTuple):
    """Boxes said; a column a box.

    Attributes:
        what: `(5, n)` sequence, track id, class code, detection of the group or -1, step.
        boxes: `(7, n)`.
        velocity_m_s: `(3, n)`.
    """

    what: NDArray[Any]
    boxes: NDArray[Any]
    velocity_m_s: NDArray[Any]


class Recorder:
    """Steps since the last hand-out, and the parts of sequences that are not finished."""

    def __init__(self, plan: Schedule, bank: FilterBank) -> None:
        """Nothing recorded yet; boxes are collected by the bank, where they are."""
        self._plan = plan
        self._bank = bank
        self._steps: list[IntArray] = []
        self._parts: dict[int, list[_Said]] = {}

    def add(
        self, step: int, identities: IntArray, detections: IntArray, rows: IntArray | slice
    ) -> None:
        """Record what a step says of some rows. Nothing is synchronised here.

        Args:
            step: number of the step.
            identities: `(3, k)` sequence, track id and class code.
            detections: `(k,)` matched detections, -1 where there is none.
            rows: the rows.
        """
        if not len(detections):
            return
        what = np.empty((5, len(detections)), np.int64)
        what[:3], what[3], what[4] = identities, detections, step
        self._steps.append(what)
        self._bank.say(rows)

    def finish(self, sequence: int) -> SequenceTracks:
        """All boxes of a finished sequence, sorted by frame and track; they are forgotten here."""
        self._distribute()
        parts = self._parts.pop(sequence, [])
        if not parts:
            return SequenceTracks.empty()
        joined = (np.concatenate(columns, axis=1) for columns in zip(*parts, strict=True))
        return self._tracks(sequence, _Said(*joined))

    def _distribute(self) -> None:
        """Sort what was said since the last hand-out by sequence."""
        if not self._steps:
            return
        what = np.concatenate(self._steps, axis=1)
        self._steps.clear()
        order = np.argsort(what[0], kind="stable")
        said = _Said(*(column[:, order] for column in (what, *self._bank.said())))
        numbers, starts = np.unique(said.what[0], return_index=True)
        ends = [*starts[1:], len(order)]
        for number, start, end in zip(numbers.tolist(), starts, ends, strict=True):
            part = _Said(*(column[:, start:end] for column in said))
            self._parts.setdefault(number, []).append(part)

    def _tracks(self, sequence: int, said: _Said) -> SequenceTracks:
        order = np.lexsort((said.what[1], said.what[4]))
        _, track_id, class_code, detection, step = said.what[:, order]
        seen = detection >= 0
        return SequenceTracks(
            frame_index=step - self._plan.first_step[sequence],
            track_id=track_id,
            class_code=class_code,
            state=np.where(seen, TrackState.DETECTED, TrackState.COASTED).astype(np.int8),
            score=np.where(seen, self._plan.scores[detection], np.nan),
            boxes=said.boxes.T[order],
            velocity_m_s=said.velocity_m_s.T[order].astype(np.float64),
            detection_row=np.where(seen, self._plan.row[detection], -1),
        )
