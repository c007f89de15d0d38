"""The lock step: all sequences of a group taken through its timetable at once."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hbbatch.tracking.schedule import Schedule
from hbbatch.tracking.steps import Steps
from hbbatch.tracking.tracks import SequenceTracks, StageSeconds


class LockStep:
    """A group being tracked."""

    def __init__(self, plan: Schedule, steps: Steps) -> None:
        """Start with no track.

        Args:
            plan: timetable and detections of the group.
            steps: those of this group, none done yet.
        """
        self._plan = plan
        self._steps = steps
        self._work = np.zeros(len(plan.first_step))
        self._counted = 0
        self._clock = StageSeconds()

    def run(self) -> Iterator[tuple[int, SequenceTracks, StageSeconds]]:
        """Step through the timetable; yields (sequence number, its boxes, its share of time)."""
        for sequence in self._plan.empty:
            yield sequence, SequenceTracks.empty(), StageSeconds()
        done = 0
        for step, ending in enumerate(self._plan.ending):
            if not ending:
                continue
            self._clock = StageSeconds.total([self._clock, self._steps.run(done, step + 1)])
            done = step + 1
            for sequence in ending:
                yield sequence, self._finish(sequence), self._share(step, sequence)

    def _finish(self, sequence: int) -> SequenceTracks:
        self._steps.end(sequence)
        recorder = self._steps.recorder
        places = recorder.places_of(sequence)
        return recorder.tracks(sequence, places, self._steps.said(places))

    def _share(self, step: int, sequence: int) -> StageSeconds:
        """The sequence's part of the time so far, by detections; it leaves the account."""
        start, self._counted = self._counted, int(self._plan.offsets[step + 1])
        seen = self._plan.sequence[start : self._counted]
        self._work += np.bincount(seen, minlength=len(self._work))
        total = self._work.sum()
        part = self._work[sequence] / total if total else 1.0
        self._work[sequence] = 0.0
        clock = self._clock
        share = StageSeconds(*(part * seconds for seconds in vars(clock).values()))
        self._clock = StageSeconds(*((1 - part) * seconds for seconds in vars(clock).values()))
        return share
