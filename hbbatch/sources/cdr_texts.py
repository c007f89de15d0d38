"""Texts of many messages told apart at once, as words of eight letters each."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.sources.base import IntArray

WORD_LETTERS: Final = 8
_FEW_KINDS: Final = 16


def masks(words: int) -> NDArray[np.uint64]:
    """By number of letters, which bits of some words hold them, `(8 * words + 1, words)`."""
    letters = np.arange(words * WORD_LETTERS)
    kept = np.arange(words * WORD_LETTERS + 1)[:, None] > letters
    return (kept * np.uint8(0xFF)).view("<u8")


def distinct(rows: NDArray[np.uint64]) -> tuple[list[int], IntArray]:
    """The first row of each kind, and which kind each row is; rows are `(n, words)`."""
    keys = rows[:, 0]
    for column in range(1, rows.shape[1]):
        keys = keys * np.uint64(0x9E3779B97F4A7C15) + rows[:, column]
    first, codes = _distinct_keys(keys)
    # Different rows may have the same key, if rarely.
    columns = rows.T if rows.shape[1] > 1 else ()
    if not all((column == column[first].take(codes)).all() for column in columns):
        _, places, numbers = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        return places.tolist(), numbers.reshape(-1).astype(np.int64)
    return first, codes


def _distinct_keys(keys: NDArray[np.uint64]) -> tuple[list[int], IntArray]:
    """As above; most often there are few, which are found faster than by sorting."""
    codes = np.zeros(len(keys), dtype=np.int64)
    first: list[int] = []
    left = np.flatnonzero(keys != keys[0])
    place = 0
    while len(first) < _FEW_KINDS:
        first.append(place)
        if not len(left):
            return first, codes
        place = int(left[0])
        codes[left] += 1
        left = left[keys[left] != keys[place]]
    _, places, numbers = np.unique(keys, return_index=True, return_inverse=True)
    return places.tolist(), numbers.astype(np.int64)
