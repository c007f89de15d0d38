"""Lock steps on a CPU: compiled, filter and association and bookkeeping (`packed/c/steps.c`)."""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np
from threadpoolctl import threadpool_limits

from hbbatch.boxes import FloatArray
from hbbatch.config import AssociationSettings, TrackSettings
from hbbatch.errors import WeightsError
from hbbatch.model.weights_files import WeightsFile
from hbbatch.packed import kernels
from hbbatch.packed.arrays import KnownArrays, SaidArrays, StepArrays, TrackArrays
from hbbatch.packed.filters import packed_filter
from hbbatch.packed.kalman import PackedKalman
from hbbatch.tracking.association import COMPILED_COST, Matcher, Priors, matcher
from hbbatch.tracking.costs import reach_over_radius
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.recorder import Recorder, Said, with_room
from hbbatch.tracking.rows import CELLS
from hbbatch.tracking.schedule import Schedule
from hbbatch.tracking.steps import MakeSteps, blocks, most_coasted
from hbbatch.tracking.tracks import StageSeconds

_FIRST_COLUMNS: Final = 64

_LINE: Final = 16
"""Columns of four bytes that a cache takes at once."""

_STEPS_AT_ONCE: Final = 256
"""Between which the interpreter hears of an interrupt: rarely more than some tenths of a second."""

_TRACKS, _PLACES, _PREDICTED, _CORRECTED = range(4)
_FIRST, _SEQUENCE, _BLOCK = map(CELLS.index, ("first", "sequence", "block"))


def compiled_steps(file: WeightsFile) -> MakeSteps:
    """Steps with the filter of a weights file; numpy multiplies in one thread from here on.

    What is left to it gains nothing from a second thread, and loses where that has to wait for a
    core that another worker has.

    Raises:
        WeightsError: the file does not fit this version's filters.
    """
    threadpool_limits(1, user_api="blas")
    header = file.header
    try:
        motion = packed_filter(header.filter, header.kinds, header.options, file.parameters())
    except WeightsError as error:
        raise file.misfit(str(error)) from error
    return lambda plan, kinds, settings: CompiledSteps(motion, plan, kinds, settings)


class CompiledSteps:
    """`Steps` with a column a track; what each detection implies is worked out at once."""

    def __init__(
        self, motion: PackedKalman, plan: Schedule, kinds: IntArray, settings: TrackSettings
    ) -> None:
        """Start without tracks.

        Args:
            motion: the filter.
            plan: timetable and detections of the group.
            kinds: `(n,)` kind code of each detection.
            settings: of the run.
        """
        self.recorder = Recorder(plan)
        self._offsets = plan.offsets
        block = blocks(plan, kinds)
        known = KnownArrays(
            plan.offsets,
            plan.first_frame - plan.first_step,
            plan.sequence,
            plan.place,
            block,
            kinds,
            np.ascontiguousarray(plan.boxes),
            motion.detections(plan.sight_m, kinds),
            motion.times(plan.dt_s),
        )
        self._constant = (*known, *motion.arrays(), _damping(settings))
        self._counts = np.array([0, len(plan.scores), 0, 0])
        self._seconds = np.zeros(len(vars(StageSeconds())))
        self._said_boxes: FloatArray = np.empty((len(plan.scores), 7))
        self._said_velocity_m_s: FloatArray = np.empty((len(plan.scores), 3))
        self._have(_columns(_FIRST_COLUMNS, motion.height))
        limits, said_misses = settings.management, most_coasted(settings)
        self._coasting = said_misses > 0
        threshold = settings.association.threshold
        self._match = _other_matcher(plan, block, settings.association)
        self._settings = (
            *(limits.max_misses, limits.max_misses_unconfirmed, said_misses),
            *(0.0 if self._match else reach_over_radius(threshold), threshold),
        )

    @property
    def predicted(self) -> int:
        """See `Steps.predicted`."""
        return int(self._counts[_PREDICTED])

    @property
    def corrected(self) -> int:
        """See `Steps.corrected`."""
        return int(self._counts[_CORRECTED])

    def run(self, start: int, stop: int) -> StageSeconds:
        """See `Steps.run`."""
        self._seconds[:] = 0.0
        while start < stop:
            end = min(start + _STEPS_AT_ONCE, stop)
            start = self._do(start, end)
            if start < end:
                self._make_room(int(self._offsets[start + 1] - self._offsets[start]))
        self.recorder.places = int(self._counts[_PLACES])
        return StageSeconds(*self._seconds.tolist())

    def _do(self, start: int, stop: int) -> int:
        """Steps as far as there is room; the first that there was none for."""
        recorder = self.recorder
        said = SaidArrays(recorder.first, recorder.step, self._said_boxes, self._said_velocity_m_s)
        return kernels.steps(
            *(*self._constant, *self._tracks, *said, *self._step, start, stop, *self._settings),
            partial(self._pairs, self._match) if self._match else None,
        )

    def _pairs(self, match: Matcher, count: int, start: int, stop: int) -> int:
        """Match the first tracks with the detections from start to before stop; how many pairs."""
        cells = self._tracks.cells[:, :count]
        boxes = self._step.priors[: 7 * count].reshape(7, count).T
        found = match(Priors(boxes, cells[_BLOCK], cells[_FIRST]), slice(start, stop))
        self._step.rows[: len(found.track)] = found.track
        self._step.numbers[: len(found.track)] = found.detection
        return len(found.track)

    def _make_room(self, newborn: int) -> None:
        """For a step: columns if all detections are newborn, places if all tracks coast."""
        count, places = int(self._counts[_TRACKS]), int(self._counts[_PLACES])
        if count + newborn > self._tracks.cells.shape[1]:
            larger = _columns(2 * (count + newborn), len(self._tracks.state))
            for name, matrix in larger._asdict().items():
                matrix[:, :count] = getattr(self._tracks, name)[:, :count]
            self._have(larger)
        needed = places + (count if self._coasting else 0)
        self.recorder.reserve(needed)
        self._said_boxes = with_room(self._said_boxes, needed)
        self._said_velocity_m_s = with_room(self._said_velocity_m_s, needed)

    def _have(self, tracks: TrackArrays) -> None:
        """Use other columns, and what a step of so many needs."""
        self._tracks = tracks
        columns = tracks.cells.shape[1]
        rows, numbers = np.empty((2, columns), np.int64)
        self._step = StepArrays(np.empty(7 * columns), rows, numbers, self._counts, self._seconds)

    def end(self, sequence: int) -> None:
        """See `Steps.end`: the last columns take the places of those that are dropped."""
        count = int(self._counts[_TRACKS])
        ended = self._tracks.cells[_SEQUENCE, :count] == sequence
        left = count - int(np.count_nonzero(ended))
        (gaps,), (movers,) = ended[:left].nonzero(), (~ended[left:]).nonzero()
        if len(gaps):
            for matrix in self._tracks:
                matrix[:, gaps] = matrix[:, left + movers]
        self._counts[_TRACKS] = left

    def said(self, places: IntArray) -> Said:
        """See `Steps.said`."""
        boxes = self._said_boxes.take(places, axis=0)
        return boxes, self._said_velocity_m_s.take(places, axis=0)


def _other_matcher(
    plan: Schedule, block: IntArray, association: AssociationSettings
) -> Matcher | None:
    """Who matches, if not the kernel."""
    if association.cost == COMPILED_COST:
        return None
    return matcher(plan.boxes, block, association, plan.step_of_each())


def _columns(count: int, height: int) -> TrackArrays:
    """Room for so many tracks or a few more: rows of states are an odd number of cache lines long.

    Were it a power of two, the rows of a column would drive each other out of the cache.
    """
    columns = _LINE * (-(-count // _LINE) | 1)
    return TrackArrays(
        np.empty((len(CELLS), columns), np.int64),
        np.empty((7, columns)),
        np.empty((height, columns), np.float32),
    )


def _damping(settings: TrackSettings) -> FloatArray:
    damping = settings.damping
    if not damping.enabled:
        return np.empty(0)
    most = settings.management.max_misses
    return np.array([damping.ramp_frames, damping.minimum, damping.maximum, most], float)
