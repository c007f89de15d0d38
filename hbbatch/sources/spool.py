"""Columns of numbers in memory while they are few, in an unnamed file once they are many."""

from __future__ import annotations

import os
import tempfile
import weakref
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.sources.base import IntArray

_IN_MEMORY_BYTES: Final = 64 * 2**20


class Spool:
    """Append rows block by block, then read any of them. The file ends with the object."""

    def __init__(self, columns: int, in_memory_bytes: int = _IN_MEMORY_BYTES) -> None:
        self._columns, self._limit = columns, in_memory_bytes
        self._firsts = [0]
        """First row of each block, and what will be that of the next one."""
        self._waiting: list[FloatArray] = []
        self._waiting_bytes = 0
        self._file: int | None = None

    def append(self, block: FloatArray) -> None:
        """Take n rows as their columns, `(columns, n)`; the array is kept, not copied."""
        if not block.size:
            return
        block = np.ascontiguousarray(block, dtype=np.float64)
        self._firsts.append(self._firsts[-1] + block.shape[1])
        self._waiting.append(block)
        self._waiting_bytes += block.nbytes
        if self._waiting_bytes > self._limit:
            self._flush()

    def read(self, starts: IntArray, counts: IntArray) -> FloatArray:
        """Runs of rows one after the other, `(columns, counts.sum())`.

        Args:
            starts: `(m,)` the first row of each run.
            counts: `(m,)` rows of each.
        """
        rows = np.empty((self._columns, int(counts.sum())))
        place = 0
        for first, last in _joined(starts, starts + counts):
            for block, start, end in self._pieces(first, last):
                self._copy(block, start, rows[:, place : place + end - start])
                place += end - start
        return rows

    def _pieces(self, first: int, last: int) -> Iterator[tuple[int, int, int]]:
        """Blocks that hold some rows, and which of their own rows these are."""
        while first < last:
            block = bisect_right(self._firsts, first) - 1
            start, end = self._firsts[block], min(last, self._firsts[block + 1])
            yield block, first - start, end - start
            first = end

    def _copy(self, block: int, start: int, rows: FloatArray) -> None:
        """The rows of a block from one on."""
        in_file = len(self._firsts) - 1 - len(self._waiting)
        if self._file is None or block >= in_file:
            rows[:] = self._waiting[block - in_file][:, start : start + rows.shape[1]]
            return
        first, size = self._firsts[block], self._firsts[block + 1] - self._firsts[block]
        for column in range(self._columns):
            at = first * self._columns + column * size + start
            os.preadv(self._file, [rows[column].data], at * rows.itemsize)

    def _flush(self) -> None:
        if self._file is None:
            self._file, name = tempfile.mkstemp(prefix="hbbatch-")
            Path(name).unlink()
            weakref.finalize(self, os.close, self._file)
        for block in self._waiting:
            rest = block.data.cast("B")
            while rest:
                rest = rest[os.write(self._file, rest) :]
        self._waiting, self._waiting_bytes = [], 0


def _joined(starts: IntArray, ends: IntArray) -> Iterator[tuple[int, int]]:
    """Runs of rows, those that follow one another as one."""
    is_first, is_last = np.ones((2, len(starts)), dtype=bool)
    is_first[1:] = is_last[:-1] = starts[1:] != ends[:-1]
    yield from zip(starts[is_first].tolist(), ends[is_last].tolist(), strict=True)
