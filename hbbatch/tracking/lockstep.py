"""The frame loop: predict, associate, update, manage, for all sequences of a group at once.

Host-device traffic of a step: the priors come to the host once (association needs them), row
orders and the numbers of matched detections go back. Nothing else waits for the device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from time import perf_counter

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.config import TrackSettings
from hbbatch.tracking.association import Pairs, matcher
from hbbatch.tracking.bank import FilterBank
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.recorder import Recorder
from hbbatch.tracking.rows import RowTable
from hbbatch.tracking.schedule import Schedule
from hbbatch.tracking.tracks import SequenceTracks, StageSeconds

OpenBank = Callable[[Schedule], FilterBank]
"""Makes the filter rows of a group, given its detections."""


class LockStep:
    """State of a group being tracked."""

    def __init__(
        self, plan: Schedule, bank: FilterBank, kind_of_class: IntArray, settings: TrackSettings
    ) -> None:
        """Start with no track.

        Args:
            plan: timetable and detections of the group.
            bank: an empty one for this group.
            kind_of_class: kind code of each class code.
            settings: of the run.
        """
        self._plan = plan
        self._bank = bank
        self._settings = settings
        self._rows = RowTable()
        self._recorder = Recorder(plan, bank)
        self._offsets = plan.offsets.tolist()
        self._free = np.ones(len(plan.scores), bool)
        sequences = len(plan.first_step)
        self._work = np.zeros(sequences)
        self._counted = 0
        self._clock = StageSeconds()
        self._frame_at_start = plan.first_frame - plan.first_step
        kinds = kind_of_class[plan.class_codes]
        self._block = plan.sequence * (kind_of_class.max(initial=0) + 1) + kinds
        steps = np.repeat(np.arange(plan.steps), np.diff(plan.offsets))
        self._match = matcher(plan.boxes, self._block, settings.association, steps)

    def run(self) -> Iterator[tuple[int, SequenceTracks, StageSeconds]]:
        """Step through the timetable; yields (sequence number, its boxes, its share of time)."""
        for sequence in self._plan.empty:
            yield sequence, SequenceTracks.empty(), StageSeconds()
        for step in range(self._plan.steps):
            self._step(step)
            for sequence in self._plan.ending[step]:
                self._arrange(np.flatnonzero(self._rows.sequence != sequence))
                yield sequence, self._recorder.finish(sequence), self._share(step, sequence)

    def _step(self, step: int) -> None:
        start = perf_counter()
        pairs = Pairs.none()
        predicted = start
        if len(self._rows):
            priors = self._predict(step)
            predicted = perf_counter()
            pairs = self._associate(step, priors)
        associated = perf_counter()
        patience = self._settings.management.max_misses
        order, matched, alive = self._rows.settle(pairs, patience)
        self._arrange(order)
        if len(matched):
            self._bank.update(matched)
        updated = perf_counter()
        self._manage(step, matched, alive)
        clock = self._clock
        clock.predict += predicted - start
        clock.associate += associated - predicted
        clock.update += updated - associated
        clock.manage += perf_counter() - updated

    def _predict(self, step: int) -> FloatArray:
        rows = self._rows
        damping = None
        if self._settings.damping.enabled:
            damping = scaling_factor(rows.age + 1, rows.misses, self._settings)
        return self._bank.predict(self._frame_at_start.take(rows.sequence) + step, damping)

    def _associate(self, step: int, priors: FloatArray) -> Pairs:
        """Matched (row, detection number of the group)."""
        part = slice(self._offsets[step], self._offsets[step + 1])
        return self._match(priors, self._rows.block, part)

    def _arrange(self, order: IntArray) -> None:
        self._rows.arrange(order)
        self._bank.arrange(order)

    def _manage(self, step: int, matched: IntArray, alive: int) -> None:
        """Record what is said, bury the dead, add the newborn."""
        rows = self._rows
        self._record(step, matched)
        if alive < len(rows):
            rows.truncate(alive)
            self._bank.truncate(alive)
        start, stop = self._offsets[step], self._offsets[step + 1]
        if len(matched) < stop - start:
            self._free[matched] = False
            self._give_birth(self._free[start:stop].nonzero()[0] + start)

    def _record(self, step: int, matched: IntArray) -> None:
        """Record the matched rows, which are the first, and those that are said while coasting."""
        output, rows = self._settings.output, self._rows
        count = len(matched)
        self._recorder.add(rows.first[:count], matched, np.arange(count))
        if output.protocol == "online" and output.max_coasted:
            misses = rows.misses
            (coasted,) = ((misses > 0) & (misses <= output.max_coasted)).nonzero()
            self._recorder.add_coasted(step, rows.first[coasted], coasted)

    def _give_birth(self, newborn: IntArray) -> None:
        rows, alive = self._rows, len(self._rows)
        self._bank.append(newborn)
        patience = self._settings.management.max_misses_unconfirmed
        sequence, block = self._plan.sequence.take(newborn), self._block.take(newborn)
        rows.append(newborn, sequence, block, patience)
        self._recorder.add(newborn, newborn, np.arange(alive, len(rows)))

    def _share(self, step: int, sequence: int) -> StageSeconds:
        """The sequence's part of the time so far, by detections; it leaves the account."""
        start, self._counted = self._counted, self._offsets[step + 1]
        seen = self._plan.sequence[start : self._counted]
        self._work += np.bincount(seen, minlength=len(self._work))
        total = self._work.sum()
        part = self._work[sequence] / total if total else 1.0
        self._work[sequence] = 0.0
        clock = self._clock
        share = StageSeconds(*(part * seconds for seconds in vars(clock).values()))
        self._clock = StageSeconds(*((1 - part) * seconds for seconds in vars(clock).values()))
        return share


def scaling_factor(age: IntArray, misses: IntArray, settings: TrackSettings) -> FloatArray:
    """The dynamic scaling factor α of each row's step (paper, section III-B).

    Args:
        age: `(n,)` steps since birth, this one included.
        misses: `(n,)` consecutive misses so far.
        settings: damping and management.
    """
    damping = settings.damping
    ramp = np.minimum(age / damping.ramp_frames, 1.0)
    patience = 1.0 - misses / settings.management.max_misses
    coasting = patience * (damping.maximum - damping.minimum) + damping.minimum
    factor: FloatArray = np.where(misses > 0, ramp * coasting, ramp)
    return np.where(misses >= settings.management.max_misses, damping.minimum, factor)
