"""The row table: identities and counters of the live tracks of all sequences of a group."""

from __future__ import annotations

import numpy as np

from hbbatch.tracking.frames import IntArray

_COLUMNS = 7
_COUNTERS = slice(5, 7)


class RowTable:
    """One integer matrix, a column a track, so that rearranging the tracks is one copy.

    Boxes and filter state of the same rows lie in a `FilterBank`.
    """

    def __init__(self) -> None:
        """An empty table."""
        self._cells: IntArray = np.empty((_COLUMNS, 0), np.int64)

    def __len__(self) -> int:
        return len(self.sequence)

    @property
    def sequence(self) -> IntArray:
        """`(n,)` number of the sequence in the group."""
        return self._column(0)

    @property
    def track_id(self) -> IntArray:
        """`(n,)` identity within the sequence."""
        return self._column(1)

    @property
    def class_code(self) -> IntArray:
        """`(n,)` class of the first detection."""
        return self._column(2)

    @property
    def block(self) -> IntArray:
        """`(n,)` tracks match detections of their own block only: same sequence, same kind."""
        return self._column(3)

    @property
    def patience(self) -> IntArray:
        """`(n,)` consecutive misses that end the track."""
        return self._column(4)

    @property
    def age(self) -> IntArray:
        """`(n,)` steps since birth."""
        return self._column(5)

    @property
    def misses(self) -> IntArray:
        """`(n,)` consecutive steps without a detection."""
        return self._column(6)

    def _column(self, number: int) -> IntArray:
        column: IntArray = self._cells[number]
        return column

    def count_step(self) -> None:
        """A step without a detection, for all rows: they age and miss one."""
        self._cells[_COUNTERS] += 1

    def identities(self, rows: IntArray | slice) -> IntArray:
        """`(3, k)` sequence, track id and class code of some rows."""
        cells: IntArray = self._cells[:3, rows]
        return cells

    def arrange(self, order: IntArray) -> None:
        """Row `order[i]` becomes row i; rows not named are dropped."""
        self._cells = self._cells[:, order]

    def truncate(self, count: int) -> None:
        """Drop all rows but the first."""
        self._cells = self._cells[:, :count]

    def append(
        self,
        sequence: IntArray,
        track_id: IntArray,
        class_code: IntArray,
        block: IntArray,
        patience: int,
    ) -> None:
        """Add newborn tracks."""
        born = np.zeros((_COLUMNS, len(sequence)), np.int64)
        born[:4] = sequence, track_id, class_code, block
        born[4] = patience
        self._cells = np.concatenate([self._cells, born], axis=1)
