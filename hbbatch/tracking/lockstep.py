"""The frame loop: predict, associate, update, manage, for all sequences of a group at once.

Host-device traffic of a step: the priors come to the host once (association needs them), the
matched row numbers go back. Nothing else waits for the device.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from time import perf_counter

import numpy as np
import torch
from torch import Tensor

from hbbatch.boxes import FloatArray
from hbbatch.config import TrackSettings
from hbbatch.model.filters import Measurement, MotionFilter
from hbbatch.tracking.association import Pairs, associate
from hbbatch.tracking.frames import IntArray, SequenceFrames
from hbbatch.tracking.recorder import Recorder, StepRecord
from hbbatch.tracking.rows import RowTable
from hbbatch.tracking.schedule import Schedule, schedule
from hbbatch.tracking.tracks import SequenceTracks, StageSeconds, TrackState

MAX_LANES = 64


class LockStep:
    """State of a group being tracked."""

    def __init__(
        self,
        group: Sequence[SequenceFrames],
        motion: MotionFilter,
        kind_of_class: IntArray,
        settings: TrackSettings,
        device: torch.device,
    ) -> None:
        """Lay out the group and move its detections to the device."""
        self._plan: Schedule = schedule(group, MAX_LANES)
        self._motion = motion
        self._settings = settings
        self._device = device
        self._rows = RowTable(motion.width, device)
        self._recorder = Recorder()
        self._next_id = np.ones(len(group), np.int64)
        self._work = np.zeros(len(group))
        self._kind_of_class = kind_of_class
        self._kinds = len(motion.class_names)
        self._clock = StageSeconds()
        plan = self._plan
        self._measured = Measurement(
            torch.from_numpy(plan.boxes).to(device),
            torch.from_numpy(plan.sight_m).float().to(device),
            torch.from_numpy(plan.scores).float().to(device),
        )
        self._dt = _interval_table(plan)

    def run(self) -> Iterator[tuple[int, SequenceTracks, StageSeconds]]:
        """Step through the timetable; yields (sequence number, its boxes, its share of time)."""
        for sequence in self._plan.empty:
            yield sequence, SequenceTracks.empty(), StageSeconds()
        for step in range(self._plan.steps):
            self._step(step)
            for sequence in self._plan.ending[step]:
                self._rows.keep(np.flatnonzero(self._rows.sequence != sequence))
                yield sequence, self._recorder.finish(sequence), self._share(sequence)

    def _step(self, step: int) -> None:
        start = perf_counter()
        detections = np.arange(self._plan.offsets[step], self._plan.offsets[step + 1])
        prior, state = self._predict(step)
        predicted = perf_counter()
        pairs = self._associate(prior, detections)
        associated = perf_counter()
        self._update(prior, state, pairs)
        updated = perf_counter()
        self._manage(step, pairs, detections)
        clock = self._clock
        clock.predict += predicted - start
        clock.associate += associated - predicted
        clock.update += updated - associated
        clock.manage += perf_counter() - updated
        self._work += np.bincount(self._rows.sequence, minlength=len(self._work))

    def _predict(self, step: int) -> tuple[Tensor, Tensor]:
        rows = self._rows
        if not len(rows):
            return rows.boxes, rows.state
        dt = torch.from_numpy(self._dt[step, rows.sequence]).to(self._device, non_blocking=True)
        prior, state = self._motion.predict(rows.boxes, rows.state, dt)
        damping = self._settings.damping
        if damping.enabled:
            share = scaling_factor(rows.age + 1, rows.misses, self._settings)
            factor = torch.from_numpy(share).to(self._device, non_blocking=True)[:, None]
            prior[:, :3] = torch.lerp(rows.boxes[:, :3], prior[:, :3], factor)
        return prior, state

    def _associate(self, prior: Tensor, detections: IntArray) -> Pairs:
        """Matched (row, detection number of the group)."""
        plan, rows = self._plan, self._rows
        found = associate(
            prior.cpu().numpy(),
            rows.sequence * self._kinds + self._kind_of_class[rows.class_code],
            plan.boxes[detections],
            plan.sequence[detections] * self._kinds
            + self._kind_of_class[plan.class_codes[detections]],
            self._settings.association,
        )
        return Pairs(found.track, detections[found.detection])

    def _update(self, prior: Tensor, state: Tensor, pairs: Pairs) -> None:
        rows = self._rows
        rows.boxes, rows.state = prior, state
        rows.age += 1
        rows.misses += 1
        rows.misses[pairs.track] = 0
        rows.hits[pairs.track] += 1
        if len(pairs.track):
            index = torch.from_numpy(pairs.track).to(self._device, non_blocking=True)
            seen = self._measurement(pairs.detection)
            boxes, updated = self._motion.update(prior[index], state[index], seen)
            rows.boxes.index_copy_(0, index, boxes)
            rows.state.index_copy_(0, index, updated)

    def _manage(self, step: int, pairs: Pairs, detections: IntArray) -> None:
        """Record what is said, bury the dead, add the newborn."""
        rows = self._rows
        matched = np.full(len(rows), -1)
        matched[pairs.track] = pairs.detection
        self._record(step, matched, np.flatnonzero(rows.misses <= self._longest_coast))
        limits = self._settings.management
        allowed = np.where(rows.hits > 1, limits.max_misses, limits.max_misses_unconfirmed)
        rows.keep(np.flatnonzero(rows.misses < allowed))
        unmatched = np.ones(len(detections), bool)
        unmatched[pairs.detection - self._plan.offsets[step]] = False
        self._give_birth(step, detections[unmatched])

    @property
    def _longest_coast(self) -> int:
        output = self._settings.output
        return output.max_coasted if output.protocol == "online" else 0

    def _give_birth(self, step: int, newborn: IntArray) -> None:
        if not len(newborn):
            return
        plan, rows = self._plan, self._rows
        sequence, code = plan.sequence[newborn], plan.class_codes[newborn]
        seen = self._measurement(newborn)
        state = self._motion.birth(
            seen, torch.from_numpy(self._kind_of_class[code]).to(self._device)
        )
        first = len(rows)
        rows.append(sequence, self._new_ids(sequence), code, seen.boxes, state)
        self._record(
            step,
            np.concatenate([np.full(first, -1), newborn]),
            np.arange(first, len(rows)),
        )

    def _new_ids(self, sequence: IntArray) -> IntArray:
        """Consecutive ids within each sequence; newborns are sorted by sequence."""
        first = np.searchsorted(sequence, sequence)
        ids = self._next_id[sequence] + np.arange(len(sequence)) - first
        self._next_id += np.bincount(sequence, minlength=len(self._next_id))
        return ids

    def _record(self, step: int, matched: IntArray, said: IntArray) -> None:
        plan, rows = self._plan, self._rows
        detection = matched[said]
        seen = detection >= 0
        index = torch.from_numpy(said).to(self._device, non_blocking=True)
        sequence = rows.sequence[said]
        self._recorder.add(
            StepRecord(
                sequence=sequence,
                frame_index=step - plan.first_step[sequence],
                track_id=rows.track_id[said],
                class_code=rows.class_code[said],
                state=np.where(seen, TrackState.DETECTED, TrackState.COASTED).astype(np.int8),
                score=np.where(seen, plan.scores[detection], np.nan),
                detection_row=np.where(seen, plan.row[detection], -1),
                boxes=rows.boxes.index_select(0, index),
                velocity=self._motion.velocity(rows.state.index_select(0, index)),
            )
        )

    def _measurement(self, detections: IntArray) -> Measurement:
        index = torch.from_numpy(detections).to(self._device, non_blocking=True)
        return Measurement(*(column.index_select(0, index) for column in self._measured))

    def _share(self, sequence: int) -> StageSeconds:
        """The sequence's part of the time so far, by track steps; it leaves the account."""
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


def _interval_table(plan: Schedule) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """`(steps, sequences)` seconds since the previous frame of each sequence."""
    table = np.zeros((plan.steps, len(plan.dt_s)), np.float32)
    for number, (first, dt) in enumerate(zip(plan.first_step, plan.dt_s, strict=True)):
        table[first : first + len(dt), number] = dt
    return table
