"""Lock steps with the filter's torch modules on any device; all else is numpy on the host.

This is what the compiled steps (`packed/c/steps.c`) do, too, written to be read.

Host-device traffic of a step: the priors come to the host once (association needs them), row
orders and the numbers of matched detections go back. Nothing else waits for the device.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.config import TrackSettings
from hbbatch.model.weights_files import WeightsFile
from hbbatch.tracking.association import Pairs, Priors, matcher
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.recorder import Recorder, Said
from hbbatch.tracking.rows import RowTable
from hbbatch.tracking.schedule import Schedule
from hbbatch.tracking.steps import MakeSteps, blocks, most_coasted
from hbbatch.tracking.tensor_bank import TensorBank, tensor_banks
from hbbatch.tracking.tracks import StageSeconds


def eager_steps(file: WeightsFile, device: str) -> MakeSteps:
    """Steps with the filter of a weights file, on a device.

    Raises:
        WeightsError: the file does not fit this version's filters.
    """
    make = tensor_banks(file, device)
    return lambda plan, kinds, settings: EagerSteps(make(plan, kinds), plan, kinds, settings)


class EagerSteps:
    """`Steps` with a row a track, in a table on the host and a bank on the device."""

    def __init__(
        self, bank: TensorBank, plan: Schedule, kinds: IntArray, settings: TrackSettings
    ) -> None:
        """Start without tracks.

        Args:
            bank: an empty one for this group.
            plan: timetable and detections of the group.
            kinds: `(n,)` kind code of each detection.
            settings: of the run.
        """
        self.recorder = Recorder(plan)
        self.predicted = self.corrected = 0
        self._plan = plan
        self._bank = bank
        self._settings = settings
        self._rows = RowTable()
        self._offsets = plan.offsets.tolist()
        self._free = np.ones(len(plan.scores), bool)
        self._frame_at_start = plan.first_frame - plan.first_step
        self._block = blocks(plan, kinds)
        self._most_coasted = most_coasted(settings)
        steps = plan.step_of_each()
        self._match = matcher(plan.boxes, self._block, settings.association, steps)

    def run(self, start: int, stop: int) -> StageSeconds:
        """See `Steps.run`."""
        clock = StageSeconds()
        for step in range(start, stop):
            self._step(step, clock)
        return clock

    def _step(self, step: int, clock: StageSeconds) -> None:
        start = perf_counter()
        pairs = Pairs.none()
        predicted = start
        if len(self._rows):
            priors = self._predict(step)
            predicted = perf_counter()
            pairs = self._associate(step, priors)
        associated = perf_counter()
        order, alive = self._rows.settle(pairs, self._settings.management.max_misses)
        self._arrange(order)
        matched = pairs.detection
        if len(matched):
            self._bank.update(matched)
        self.corrected += len(matched)
        updated = perf_counter()
        self._manage(step, matched, alive)
        clock.predict += predicted - start
        clock.associate += associated - predicted
        clock.update += updated - associated
        clock.manage += perf_counter() - updated

    def _predict(self, step: int) -> FloatArray:
        rows = self._rows
        damping = None
        if self._settings.damping.enabled:
            damping = scaling_factor(rows.age + 1, rows.misses, self._settings)
        self.predicted += len(rows)
        return self._bank.predict(self._frame_at_start.take(rows.sequence) + step, damping)

    def _associate(self, step: int, priors: FloatArray) -> Pairs:
        """Matched (row, detection number of the group)."""
        part = slice(self._offsets[step], self._offsets[step + 1])
        return self._match(Priors(priors, self._rows.block, self._rows.first), part)

    def _arrange(self, order: IntArray) -> None:
        self._rows.arrange(order)
        self._bank.arrange(order)

    def _manage(self, step: int, matched: IntArray, alive: int) -> None:
        """Record what is said, bury the dead, add the newborn."""
        rows = self._rows
        self._record(np.arange(len(matched)), self._plan.place.take(matched))
        if self._most_coasted:
            self._record_coasted(step)
        if alive < len(rows):
            rows.truncate(alive)
            self._bank.truncate(alive)
        start, stop = self._offsets[step], self._offsets[step + 1]
        if len(matched) < stop - start:
            self._free[matched] = False
            self._give_birth(self._free[start:stop].nonzero()[0] + start)

    def _record(self, rows: IntArray, places: IntArray) -> None:
        self.recorder.first[places] = self._rows.first[rows]
        self._bank.say(rows, places)

    def _record_coasted(self, step: int) -> None:
        """Record the rows that are said although nothing was detected."""
        misses, recorder = self._rows.misses, self.recorder
        (coasted,) = ((misses > 0) & (misses <= self._most_coasted)).nonzero()
        if not len(coasted):
            return
        places = np.arange(recorder.places, recorder.places + len(coasted))
        recorder.places += len(coasted)
        recorder.reserve(recorder.places)
        self._bank.reserve(recorder.places)
        recorder.step[places] = step
        self._record(coasted, places)

    def _give_birth(self, newborn: IntArray) -> None:
        rows, alive = self._rows, len(self._rows)
        self._bank.append(newborn)
        patience = self._settings.management.max_misses_unconfirmed
        places, sequence = self._plan.place.take(newborn), self._plan.sequence.take(newborn)
        rows.append(places, sequence, self._block.take(newborn), patience)
        self._record(np.arange(alive, len(rows)), places)

    def end(self, sequence: int) -> None:
        """See `Steps.end`."""
        self._arrange(np.flatnonzero(self._rows.sequence != sequence))

    def said(self, places: IntArray) -> Said:
        """See `Steps.said`."""
        return self._bank.said(places)


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
