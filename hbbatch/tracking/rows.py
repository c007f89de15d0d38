"""The row table: identities and counters of the live tracks of all sequences of a group."""

from __future__ import annotations

import numpy as np

from hbbatch.packed import kernels
from hbbatch.packed.room import Room
from hbbatch.tracking.association import Pairs
from hbbatch.tracking.frames import IntArray

_FIRST, _SEQUENCE, _BLOCK, _PATIENCE, _AGE, _MISSES = range(6)


class RowTable:
    """One integer matrix, a column a track, so that rearranging the tracks is one copy.

    Boxes and filter state of the same rows lie in a `FilterBank`. What is handed out is a view of
    the matrix, until it is arranged again.
    """

    def __init__(self) -> None:
        """An empty table."""
        self._cells: Room[np.int64] = Room(6, np.int64)

    def __len__(self) -> int:
        return self._cells.count

    @property
    def first(self) -> IntArray:
        """`(n,)` the detection of the group that the track was born from: who it is."""
        return self._cells.row(_FIRST)

    @property
    def sequence(self) -> IntArray:
        """`(n,)` number of the sequence in the group."""
        return self._cells.row(_SEQUENCE)

    @property
    def block(self) -> IntArray:
        """`(n,)` tracks match detections of their own block only: same sequence, same kind."""
        return self._cells.row(_BLOCK)

    @property
    def age(self) -> IntArray:
        """`(n,)` steps since birth."""
        return self._cells.row(_AGE)

    @property
    def misses(self) -> IntArray:
        """`(n,)` consecutive steps without a detection."""
        return self._cells.row(_MISSES)

    def settle(self, pairs: Pairs, max_misses: int) -> tuple[IntArray, IntArray, int]:
        """Count a step: all rows age, and all but the matched ones miss one.

        Args:
            pairs: rows that are matched, each once, and their detections.
            max_misses: consecutive misses that end a track, for matched rows from now on.

        Returns:
            The order in which matched rows come first and those that die last; detections of the
            matched rows in that order; how many rows live on.
        """
        if not kernels.AVAILABLE:
            return self.settle_any(pairs, max_misses)
        order, detections = np.empty(len(self), np.int64), pairs.detection.copy()
        cells = self._cells.whole
        alive = kernels.settle(cells, pairs.track, detections, order, len(self), max_misses)
        return order, detections, alive

    def settle_any(self, pairs: Pairs, max_misses: int) -> tuple[IntArray, IntArray, int]:
        """`settle` in numpy."""
        misses, patience = self.misses, self._cells.row(_PATIENCE)
        self.age[:] += 1
        misses += 1
        misses[pairs.track] = 0
        patience[pairs.track] = max_misses
        (missed,) = misses.nonzero()
        lives = misses[missed] < patience[missed]
        order = np.concatenate([pairs.track, missed[lives], missed[~lives]])
        return order, pairs.detection, len(pairs.track) + int(np.count_nonzero(lives))

    def arrange(self, order: IntArray) -> None:
        """Row `order[i]` becomes row i; rows not named are dropped."""
        self._cells.arrange(order)

    def truncate(self, count: int) -> None:
        """Drop all rows but the first."""
        self._cells.truncate(count)

    def append(self, first: IntArray, sequence: IntArray, block: IntArray, patience: int) -> None:
        """Add newborn tracks."""
        new = self._cells.append(len(first))
        cells = self._cells.whole
        cells[_FIRST, new], cells[_SEQUENCE, new], cells[_BLOCK, new] = first, sequence, block
        cells[_PATIENCE, new] = patience
        cells[_AGE:, new] = 0
