"""Filter rows on the CPU: numpy arrays stepped by a packed filter."""

from __future__ import annotations

import numpy as np
from threadpoolctl import threadpool_limits

from hbbatch.boxes import FloatArray
from hbbatch.errors import WeightsError
from hbbatch.model.weights_files import WeightsFile
from hbbatch.packed import kernels
from hbbatch.packed.filters import packed_filter
from hbbatch.packed.kalman import PackedKalman
from hbbatch.packed.room import Room
from hbbatch.tracking.bank import MakeBank, Said, with_room
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.schedule import Schedule


def packed_banks(file: WeightsFile) -> MakeBank:
    """Banks of the packed filter of a weights file; numpy multiplies in one thread from here on.

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
    return lambda plan, kinds: PackedBank(motion, plan, kinds)


class PackedBank:
    """A `FilterBank` with a column a track; what each detection implies is worked out at once."""

    def __init__(self, motion: PackedKalman, plan: Schedule, kinds: IntArray) -> None:
        """Start without rows.

        Args:
            motion: the filter.
            plan: the group's detections.
            kinds: `(n,)` kind code of each detection.
        """
        self._motion = motion
        self._kinds = kinds
        self._measured = np.ascontiguousarray(plan.boxes)
        self._times = motion.times(plan.dt_s)
        self._seen = motion.detections(plan.sight_m, kinds)
        self._boxes: Room[np.float64] = Room(7, np.float64)
        self._state: Room[np.float32] = Room(motion.height, np.float32)
        self._said_boxes: FloatArray = np.empty((len(plan.scores), 7))
        self._said_velocity: FloatArray = np.empty((len(plan.scores), 3))

    def predict(self, frames: IntArray, damping: FloatArray | None) -> FloatArray:
        """See `FilterBank.predict`."""
        boxes, state = self._boxes.whole, self._state.whole
        return self._motion.predict(boxes, state, self._times, frames, damping).T

    def arrange(self, order: IntArray) -> None:
        """See `FilterBank.arrange`."""
        self._boxes.arrange(order)
        self._state.arrange(order)

    def update(self, detections: IntArray) -> None:
        """See `FilterBank.update`."""
        boxes, state = self._boxes.whole, self._state.whole
        self._motion.update(boxes, state, self._measured, self._seen, detections)

    def truncate(self, count: int) -> None:
        """See `FilterBank.truncate`."""
        self._boxes.truncate(count)
        self._state.truncate(count)

    def append(self, detections: IntArray) -> None:
        """See `FilterBank.append`."""
        first = self._boxes.append(len(detections)).start
        self._state.append(len(detections))
        self._motion.birth(
            self._boxes.whole,
            self._state.whole,
            self._measured,
            self._seen,
            detections,
            self._kinds,
            first,
        )

    def reserve(self, places: int) -> None:
        """See `FilterBank.reserve`."""
        self._said_boxes = with_room(self._said_boxes, places)
        self._said_velocity = with_room(self._said_velocity, places)

    def say(self, rows: IntArray, places: IntArray) -> None:
        """See `FilterBank.say`."""
        kernels.say(
            self._boxes.whole,
            self._state.whole,
            rows,
            places,
            self._said_boxes,
            self._said_velocity,
            self._motion.velocity,
        )

    def said(self, places: IntArray) -> Said:
        """See `FilterBank.said`."""
        boxes = self._said_boxes.take(places, axis=0)
        return boxes, self._said_velocity.take(places, axis=0)
