"""Boxes and filter state of the live tracks, whatever computes them.

Rows are in the order of the `RowTable`. After association the matched tracks are moved to the
front, so that the update works on a prefix and nothing is scattered.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.schedule import Schedule

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


class FilterBank(Protocol):
    """What a lock step needs of a filter and its rows."""

    def predict(self, frames: IntArray, damping: FloatArray | None) -> FloatArray:
        """Take each row on to a frame `(n,)` of the group; their prior boxes `(n, 7)`.

        With `damping` `(n,)` given, centres move by that share of the predicted step.
        """

    def arrange(self, order: IntArray) -> None:
        """Row `order[i]` becomes row i; rows not named are dropped."""

    def update(self, detections: IntArray) -> None:
        """Correct the first rows by these detections of the group."""

    def truncate(self, count: int) -> None:
        """Drop all rows but the first."""

    def append(self, detections: IntArray) -> None:
        """Add rows born from detections of the group."""

    def reserve(self, places: int) -> None:
        """Have so many places, those of the group's detections counted."""

    def say(self, rows: IntArray, places: IntArray) -> None:
        """Remember the boxes and velocities of some rows as they are now, each in its place.

        Places are the numbers of the group's detections, and those reserved after them.
        """

    def said(self, places: IntArray) -> Said:
        """What was said in these places."""


MakeBank = Callable[[Schedule, IntArray], FilterBank]
"""A bank without rows, given a group's detections and the kind code `(n,)` of each."""
