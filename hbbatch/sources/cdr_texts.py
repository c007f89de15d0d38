"""Texts of many messages at once, as words of eight letters each."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from hbbatch.sources.base import IntArray, Names

WORD_LETTERS: Final = 8


def texts_of(words: NDArray[np.uint64], letters: IntArray) -> Names:
    """Texts.

    Args:
        words: `(n, words)` what lies where they begin; changed in place.
        letters: `(n,)` how long they are.

    Raises:
        UnicodeDecodeError: one is not UTF-8.
    """
    words &= _masks(words.shape[1]).take(letters, axis=0)
    if (words == words[:1]).all():
        # As names of frames mostly are.
        return Names(np.zeros(len(words), dtype=np.int64), tuple(map(_text, words[:1])))
    kind = pa.binary(words.shape[1] * WORD_LETTERS)
    coded = pa.Array.from_buffers(kind, len(words), [None, pa.py_buffer(words)]).dictionary_encode()
    vocabulary = tuple(map(_text, coded.dictionary.to_pylist()))
    return Names(coded.indices.to_numpy().astype(np.int64), vocabulary)


def _text(letters: NDArray[np.uint64] | bytes) -> str:
    return bytes(letters).rstrip(b"\0").decode()


@cache
def _masks(words: int) -> NDArray[np.uint64]:
    """By number of letters, which bits of some words hold them, `(8 * words + 1, words)`."""
    letters = np.arange(words * WORD_LETTERS)
    kept = np.arange(words * WORD_LETTERS + 1)[:, None] > letters
    return (kept * np.uint8(0xFF)).view("<u8")
