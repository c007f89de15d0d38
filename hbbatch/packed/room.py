"""Matrices with a column a track, which come and go."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from hbbatch.packed import kernels
from hbbatch.packed.arrays import IntArray

Scalar = TypeVar("Scalar", bound=np.generic)

_FIRST_COLUMNS = 64

_LINE = 16
"""Columns of four bytes that a cache takes at once."""


class Room(Generic[Scalar]):
    """A matrix whose first columns are used and whose others are spare.

    Attributes:
        whole: `(height, columns)`, contiguous; replaced where there is no room.
        count: columns in use.
    """

    def __init__(self, height: int, dtype: DTypeLike) -> None:
        """No column in use."""
        self.whole: NDArray[Scalar] = _matrix(height, _FIRST_COLUMNS, dtype)
        self.count = 0

    def row(self, number: int) -> NDArray[Scalar]:
        """`(count,)` a row of the columns in use, until they are arranged again."""
        row: NDArray[Scalar] = self.whole[number, : self.count]
        return row

    def arrange(self, order: IntArray) -> None:
        """Column `order[i]` becomes column i; columns not named are dropped."""
        self.count = len(order)
        if kernels.AVAILABLE:
            kernels.arrange(self.whole, order)
        else:
            self.whole[:, : self.count] = self.whole.take(order, axis=1)

    def truncate(self, count: int) -> None:
        """Drop all columns but the first."""
        self.count = count

    def append(self, count: int) -> slice:
        """Use so many more columns, which hold anything."""
        first, self.count = self.count, self.count + count
        if self.count > self.whole.shape[1]:
            larger: NDArray[Scalar] = _matrix(len(self.whole), 2 * self.count, self.whole.dtype)
            larger[:, :first] = self.whole[:, :first]
            self.whole = larger
        return slice(first, self.count)


def _matrix(height: int, columns: int, dtype: DTypeLike) -> NDArray[Any]:
    """With so many columns or a few more: an odd number of cache lines a row.

    Were it a power of two, the rows of a column would drive each other out of the cache.
    """
    return np.empty((height, _LINE * (-(-columns // _LINE) | 1)), dtype)
