"""Filter rows on the CPU: numpy arrays stepped by a packed filter."""

from __future__ import annotations

import numpy as np
from threadpoolctl import threadpool_limits

from hbbatch.boxes import FloatArray
from hbbatch.errors import WeightsError
from hbbatch.model.weights_files import WeightsFile
from hbbatch.packed.arrays import CENTRE, PACKED, Single
from hbbatch.packed.filters import packed_filter
from hbbatch.packed.kalman import PackedFilter
from hbbatch.tracking.bank import SAID_WIDTH, MakeBank, Said, with_room
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.schedule import Schedule


def packed_banks(file: WeightsFile) -> MakeBank:
    """Banks of the packed filter of a weights file; numpy multiplies in one thread from here on.

    Products of a hundred rows gain nothing from a second thread, and lose several times over where
    it has to wait for a core that another worker has.

    Raises:
        WeightsError: the file does not fit this version's filters.
    """
    threadpool_limits(1, user_api="blas")
    header = file.header
    try:
        motion = packed_filter(header.filter, header.kinds, header.options, file.parameters())
    except WeightsError as error:
        raise file.misfit(str(error)) from error
    return lambda plan, kinds: PackedBank(motion, plan, kinds)


class PackedBank:
    """A `FilterBank` with a column a track; what each detection implies is worked out at once."""

    def __init__(self, motion: PackedFilter, plan: Schedule, kinds: IntArray) -> None:
        """Start without rows.

        Args:
            motion: the filter.
            plan: the group's detections.
            kinds: `(n,)` kind code of each detection.
        """
        self._motion = motion
        self._measured = np.ascontiguousarray(plan.boxes.T[PACKED])
        self._times = motion.times(plan.dt_s)
        self._seen = motion.detections(plan.sight_m, kinds)
        self._boxes: FloatArray = np.empty((7, 0))
        self._state: Single = np.empty((motion.height, 0), np.float32)
        self._said: FloatArray = np.empty((len(plan.scores), SAID_WIDTH))

    def predict(self, frames: IntArray, damping: FloatArray | None) -> FloatArray:
        """See `FilterBank.predict`."""
        times = self._times.take(frames, axis=1)
        prior = self._motion.predict(self._boxes, self._state, times)
        if damping is not None:
            prior[CENTRE] = self._boxes[CENTRE] + damping * (prior[CENTRE] - self._boxes[CENTRE])
        self._boxes = prior
        boxes: FloatArray = prior[PACKED].T
        return boxes

    def arrange(self, order: IntArray) -> None:
        """See `FilterBank.arrange`."""
        self._boxes = self._boxes[:, order]
        self._state = self._state[:, order]

    def update(self, detections: IntArray) -> None:
        """See `FilterBank.update`."""
        first = slice(len(detections))
        measured, seen = self._measured[:, detections], self._seen[:, detections]
        self._motion.update(self._boxes[:, first], self._state[:, first], measured, seen)

    def truncate(self, count: int) -> None:
        """See `FilterBank.truncate`."""
        self._boxes = self._boxes[:, :count]
        self._state = self._state[:, :count]

    def append(self, detections: IntArray, kinds: IntArray) -> None:
        """See `FilterBank.append`."""
        boxes = self._measured[:, detections]
        born = self._motion.birth(boxes, self._seen[:, detections], kinds)
        self._boxes = np.concatenate([self._boxes, boxes], axis=1)
        self._state = np.concatenate([self._state, born], axis=1)

    def say(self, rows: IntArray | slice, places: IntArray) -> None:
        """See `FilterBank.say`."""
        self._said = with_room(self._said, int(places.max(initial=-1)) + 1)
        self._said[places, :7] = self._boxes[:, rows][PACKED].T
        self._said[places, 7:] = self._motion.velocity(self._state)[:, rows].T

    def said(self, places: IntArray) -> Said:
        """See `FilterBank.said`."""
        said = self._said[places]
        return said[:, :7].copy(), said[:, 7:].copy()
