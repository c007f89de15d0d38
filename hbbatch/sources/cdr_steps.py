"""What to do with the bytes of a CDR message to get at chosen fields, from its definition.

CDR: plain, little endian, alignment relative to the byte behind the four of the encapsulation
(OMG DDSI-RTPS, version 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Any, Final

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from hbbatch.sources.base import IntArray

TYPES: Final = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "f4", "f8")
"""Numbers that can be taken, as `c/cdr.c` counts them."""

_DTYPES: Final = {
    "bool": "u1",
    "byte": "u1",
    "octet": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
_LENGTH_BYTES: Final = 4
_WIDEST: Final = 8
_MOST_FIELDS: Final = 4096
"""Definitions may multiply fields by fields; of those that are read none has a tenth of these."""


class WalkRefusedError(Exception):
    """The walk is not for these messages, or the definition lacks a field."""


class Operation(IntEnum):
    """What a step does with the bytes that lie some way behind the position."""

    ALIGN = 0
    """The position goes there, then down to a multiple."""
    TAKE = 1
    """Numbers of one type that lie there side by side are wanted."""
    TEXT = 2
    """There is a text; the position goes behind it."""
    NUMBERS = 3
    """There is a sequence of numbers; the position goes behind it."""
    REPEAT = 4
    """There is a sequence of anything else; the position goes to each element, then behind all."""


class Kind(Enum):
    """What the cells of a column are."""

    REAL = "floating-point numbers"
    WHOLE = "integers"
    TEXT = "codes of a vocabulary"
    COUNT = "elements that a sequence has"


@dataclass(frozen=True)
class Column:
    """Where a wanted field goes, or how long a sequence is.

    Attributes:
        path: of the field or sequence.
        level: which rows it has.
        kind: what its cells are.
    """

    path: str
    level: int
    kind: Kind


@dataclass(frozen=True)
class Layout:
    """The steps through a message.

    The position moves only where it must, by what a message says: fixed distances are part of where
    the steps look.

    Attributes:
        steps: `(n, 5)` an operation, how far behind the position, and what `c/cdr.c` says.
        columns: those that the steps fill; the columns of fields of one type that lie side by side
            follow one another.
        smallest: by level, bytes that a row takes at the least. Level 0 has a row a message, each
            other one a row an element of its sequence.
    """

    steps: IntArray
    columns: Sequence[Column]
    smallest: Sequence[int]


def compiled(store: Typestore, kind: str, wanted: Sequence[str]) -> Layout:
    """The steps through a message.

    Args:
        store: holds the definition.
        kind: type of the messages.
        wanted: paths such as `header.frame_id` or `detections[].bbox.size.x`.

    Raises:
        WalkRefusedError: a field is not there, or the definition holds what CDR walks do not.
    """
    compiler = _Compiler(store, frozenset(wanted))
    compiler.message(kind)
    missing = set(wanted) - compiler.found
    if missing:
        raise WalkRefusedError(f"no field {', '.join(sorted(missing))}")
    try:
        steps = np.array(compiler.steps, dtype=np.int64).reshape(-1, 5)
    except OverflowError as error:
        raise WalkRefusedError("an array beyond all memory") from error
    return Layout(steps, compiler.columns, compiler.smallest)


class _Compiler:
    """Definition to steps; keeps what is known of the alignment."""

    def __init__(self, store: Typestore, wanted: frozenset[str]) -> None:
        self._store, self._wanted = store, wanted
        self._modulus, self._remainder = _WIDEST, 0
        self._ahead = self._level = self._fields = self._texts = 0
        self._numbers: list[int] | None = None
        """The last step, where it takes numbers."""
        self.steps: list[list[int]] = []
        self.columns: list[Column] = []
        self.smallest = [0]
        self.found: set[str] = set()

    def message(self, kind: str) -> None:
        self._struct(kind, "")
        self._end()

    def _struct(self, kind: str, prefix: str) -> None:
        for name, (node, argument) in self._store.fielddefs[kind][1]:
            self._field(node, argument, f"{prefix}{name}")

    def _field(self, node: Any, argument: Any, path: str) -> None:
        self._fields += 1
        if self._fields > _MOST_FIELDS:
            raise WalkRefusedError("too many fields")
        if node == Nodetype.NAME:
            self._struct(argument, f"{path}.")
        elif node == Nodetype.BASE:
            self._base(argument[0], path)
        elif node == Nodetype.ARRAY:
            self._array(argument[0], argument[1], f"{path}[]")
        else:
            self._sequence(argument[0], path)

    def _base(self, kind: str, path: str) -> None:
        if kind == "string":
            self._length(Operation.TEXT, *self._text(path))
        elif kind in _DTYPES:
            self._number(_DTYPES[kind], path)
        else:
            raise WalkRefusedError(f"values of type {kind}")

    def _text(self, path: str) -> tuple[int, int]:
        """Column and vocabulary of a text."""
        if not self._is_wanted(path):
            return -1, -1
        self._texts += 1
        return self._column(Column(path, self._level, Kind.TEXT)), self._texts - 1

    def _number(self, dtype: str, path: str) -> None:
        size = int(dtype[1])
        self._to(size)
        if self._is_wanted(path):
            self._take(dtype, path)
        self._pass(size)

    def _take(self, dtype: str, path: str) -> None:
        if dtype not in TYPES:
            raise WalkRefusedError(f"values of type {dtype}")
        last, size, code = self._numbers, int(dtype[1]), TYPES.index(dtype)
        kind = Kind.REAL if dtype.startswith("f") else Kind.WHOLE
        column = self._column(Column(path, self._level, kind))
        if last and (last[2], last[1] + last[3] * size) == (code, self._ahead):
            last[3] += 1
        else:
            self._numbers = [Operation.TAKE, self._ahead, code, 1, column]
            self.steps.append(self._numbers)

    def _array(self, item: Any, count: int, path: str) -> None:
        node, argument = item
        kind = argument[0] if node == Nodetype.BASE else ""
        if count and kind in _DTYPES and path not in self._wanted:
            size = int(_DTYPES[kind][1])
            self._to(size)
            self._pass(count * size)
            return
        for _ in range(count):
            self._field(node, argument, path)

    def _sequence(self, item: Any, path: str) -> None:
        node, argument = item
        if node == Nodetype.BASE and argument[0] in _DTYPES:
            self._length(Operation.NUMBERS, int(_DTYPES[argument[0]][1]))
            return
        outer, inner = self._level, len(self.smallest)
        counts = self._column(Column(path, outer, Kind.COUNT))
        step = self._length(Operation.REPEAT, 0, inner, counts)
        first, self._level = len(self.steps), inner
        self.smallest.append(0)
        # The first element may lie anywhere that the ones before leave it.
        self._field(node, argument, f"{path}[]")
        self._end()
        if not self.smallest[inner]:
            raise WalkRefusedError("elements without fields")
        step[2], self._level = len(self.steps) - first, outer
        self._modulus, self._remainder = 1, 0

    def _column(self, column: Column) -> int:
        self.columns.append(column)
        return len(self.columns) - 1

    def _is_wanted(self, path: str) -> bool:
        if path not in self._wanted:
            return False
        if path in self.found:
            raise WalkRefusedError(f"{path} is in a fixed array")
        self.found.add(path)
        return True

    def _length(self, operation: Operation, *words: int) -> list[int]:
        """A step that reads a length, behind which the position may be anywhere."""
        self._to(_LENGTH_BYTES)
        step = self._step(operation, *words)
        self.smallest[self._level] += _LENGTH_BYTES
        self._modulus, self._remainder = 1, 0
        return step

    def _to(self, multiple: int) -> None:
        if self._modulus >= multiple:
            padding = -self._remainder % multiple
            self._ahead += padding
            self._remainder = (self._remainder + padding) % self._modulus
        else:
            self._ahead += multiple - 1
            self._step(Operation.ALIGN, multiple)
            self._modulus, self._remainder = multiple, 0

    def _pass(self, count: int) -> None:
        self._ahead += count
        self.smallest[self._level] += count
        self._remainder = (self._remainder + count) % self._modulus

    def _end(self) -> None:
        """The position goes behind the last field."""
        if self._ahead:
            self._step(Operation.ALIGN, 1)

    def _step(self, operation: Operation, *words: int) -> list[int]:
        """Add a step that moves the position."""
        step = [operation, self._ahead, *words, *(0,) * (3 - len(words))]
        self.steps.append(step)
        self._ahead, self._numbers = 0, None
        return step
