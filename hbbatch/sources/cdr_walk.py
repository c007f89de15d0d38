"""Chosen fields of many CDR messages at once, without making an object of any message.

The walk is compiled from the definition that the log embeds (`cdr_steps`), so it holds for exactly
that layout, and taken by a function in C (`c/cdr.c`). A message that does not fit makes the walk
refuse the whole batch, which is then read message by message; so is everything where the extension
was not built (docs/adr/0009-compiled-walk.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.store import Typestore

from hbbatch.boxes import FloatArray
from hbbatch.sources.base import IntArray, Names
from hbbatch.sources.blocks import Payloads
from hbbatch.sources.cdr_steps import Column, Kind, Layout, WalkRefusedError, compiled

AVAILABLE: Final = find_spec("hbbatch.sources._cdr") is not None
"""Whether the extension was built."""

if AVAILABLE:
    from hbbatch.sources._cdr import walk


@dataclass(frozen=True)
class Columns:
    """Fields of a batch of messages.

    Attributes:
        counts: by path of a sequence, how many elements it has in each message, or element of the
            sequence that it lies in.
        numbers: by path, a value a message or element, in order.
        texts: by path, a text a message or element, in order.
    """

    counts: dict[str, IntArray]
    numbers: dict[str, NDArray[Any]]
    texts: dict[str, Names]

    def stack(self, paths: Sequence[str]) -> FloatArray:
        """Several numeric columns side by side, `(n, len(paths))`, each of them contiguous."""
        return np.stack([self.numbers[path] for path in paths], dtype=np.float64).T


class CdrWalk:
    """The walk for one message type and a choice of its fields."""

    def __init__(self, store: Typestore, kind: str, wanted: Sequence[str]) -> None:
        """Compile; arguments and errors as of `cdr_steps.compiled`."""
        if not AVAILABLE:
            raise WalkRefusedError("the extension was not built")
        self._layout = compiled(store, kind, wanted)

    def read(self, messages: Payloads) -> Columns:
        """The chosen fields of messages.

        Raises:
            WalkRefusedError: not all of them are as the definition says.
        """
        layout, rows = self._layout, _rows(self._layout, messages)
        levels = [column.level for column in layout.columns]
        room, firsts = rows[0, levels], np.zeros(len(levels), dtype=np.int64)
        firsts[1:] = np.cumsum(room)[:-1]
        cells = np.empty(int(room.sum()), dtype=np.int64)
        vocabularies: list[dict[str, int]] = [
            {} for column in layout.columns if column.kind is Kind.TEXT
        ]
        given = (messages.buffer, messages.starts, messages.ends)
        try:
            walk(layout.steps, *given, firsts, rows, cells, vocabularies)
        except ValueError as error:
            raise WalkRefusedError(str(error)) from error
        spans = zip(firsts.tolist(), rows[1, levels].tolist(), strict=True)
        filled = [cells[first : first + count] for first, count in spans]
        return _columns(layout.columns, filled, vocabularies)


def _rows(layout: Layout, messages: Payloads) -> IntArray:
    """How many rows each level can have, `(2, levels)` with a row for those that there are.

    An element takes bytes, so that messages say themselves how many they have at the most, whatever
    lengths they claim.
    """
    size = int((messages.ends - messages.starts).sum())
    room = [len(messages), *(size // smallest for smallest in layout.smallest[1:])]
    return np.array([room, [0] * len(room)], dtype=np.int64)


def _columns(
    columns: Sequence[Column], filled: Sequence[IntArray], vocabularies: Sequence[dict[str, int]]
) -> Columns:
    found, texts = Columns({}, {}, {}), iter(vocabularies)
    for column, cells in zip(columns, filled, strict=True):
        if column.kind is Kind.TEXT:
            found.texts[column.path] = Names(cells, tuple(next(texts)))
        elif column.kind is Kind.COUNT:
            found.counts[column.path] = cells
        else:
            real = column.kind is Kind.REAL
            found.numbers[column.path] = cells.view(np.float64) if real else cells
    return found
