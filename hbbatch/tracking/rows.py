"""The row table: identities and counters of the live tracks of all sequences of a group."""

from __future__ import annotations

from typing import Final

import numpy as np

from hbbatch.tracking.association import Pairs
from hbbatch.tracking.frames import IntArray

CELLS: Final = ("first", "sequence", "block", "patience", "age", "misses")
"""Rows of the table, a column a track (`packed/c/rows.h`):

the place of the detection that the track was born from, which is who it is; number of the sequence
in the group; tracks match detections of their own block only; consecutive misses that end it; steps
since birth; consecutive steps without a detection."""

_FIRST, _SEQUENCE, _BLOCK, _PATIENCE, _AGE, _MISSES = range(len(CELLS))


class RowTable:
    """One integer matrix, a column a track, so that rearranging the tracks is one copy.

    Boxes and filter state of the same rows lie in a `TensorBank`. What is handed out is a view of
    the matrix, until it is arranged again.
    """

    def __init__(self) -> None:
        """An empty table."""
        self._cells: IntArray = np.empty((len(CELLS), 0), np.int64)

    def __len__(self) -> int:
        return len(self._cells[0])

    @property
    def first(self) -> IntArray:
        """`(n,)` place of the detection that the track was born from: who it is."""
        return self._row(_FIRST)

    @property
    def sequence(self) -> IntArray:
        """`(n,)` number of the sequence in the group."""
        return self._row(_SEQUENCE)

    @property
    def block(self) -> IntArray:
        """`(n,)` tracks match detections of their own block only: same sequence, same kind."""
        return self._row(_BLOCK)

    @property
    def age(self) -> IntArray:
        """`(n,)` steps since birth."""
        return self._row(_AGE)

    @property
    def misses(self) -> IntArray:
        """`(n,)` consecutive steps without a detection."""
        return self._row(_MISSES)

    def _row(self, number: int) -> IntArray:
        row: IntArray = self._cells[number]
        return row

    def settle(self, pairs: Pairs, max_misses: int) -> tuple[IntArray, int]:
        """Count a step: all rows age, and all but the matched ones miss one.

        Args:
            pairs: rows that are matched, each once, and their detections.
            max_misses: consecutive misses that end a track, for matched rows from now on.

        Returns:
            The order in which matched rows come first, as they are given, and those that die last;
            how many rows live on.
        """
        misses, patience = self.misses, self._row(_PATIENCE)
        self.age[:] += 1
        misses += 1
        misses[pairs.track] = 0
        patience[pairs.track] = max_misses
        (missed,) = misses.nonzero()
        lives = misses[missed] < patience[missed]
        order = np.concatenate([pairs.track, missed[lives], missed[~lives]])
        return order, len(pairs.track) + int(np.count_nonzero(lives))

    def arrange(self, order: IntArray) -> None:
        """Row `order[i]` becomes row i; rows not named are dropped."""
        self._cells = self._cells.take(order, axis=1)

    def truncate(self, count: int) -> None:
        """Drop all rows but the first."""
        self._cells = self._cells[:, :count]

    def append(self, first: IntArray, sequence: IntArray, block: IntArray, patience: int) -> None:
        """Add newborn tracks."""
        new = np.zeros((len(CELLS), len(first)), np.int64)
        new[_FIRST], new[_SEQUENCE], new[_BLOCK], new[_PATIENCE] = first, sequence, block, patience
        self._cells = np.hstack([self._cells, new])
