"""Boxes and filter state of the live tracks, whatever computes them.

Rows are in the order of the `RowTable`. After association the matched tracks are moved to the
front, so that the update works on a prefix and nothing is scattered.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.schedule import Schedule

Said = tuple[FloatArray, NDArray[np.floating]]
"""Boxes `(7, n)` and velocities in m/s `(3, n)`, world frame."""


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

    def append(self, detections: IntArray, kinds: IntArray) -> None:
        """Add rows born from detections of the group."""

    def say(self, rows: IntArray | slice) -> None:
        """Remember the boxes and velocities of some rows as they are now."""

    def said(self) -> Said:
        """All that was said since the last call, in order."""


MakeBank = Callable[[Schedule, IntArray], FilterBank]
"""A bank without rows, given a group's detections and the kind code `(n,)` of each."""
