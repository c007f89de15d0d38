"""What to do with the bytes of a CDR message to get at chosen fields, from its definition.

CDR: plain, little endian, alignment relative to the byte behind the four of the encapsulation
(OMG DDSI-RTPS, version 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

LENGTH_BYTES: Final = 4
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
_WIDEST: Final = 8


class WalkRefusedError(Exception):
    """The walk is not for these messages, or the definition lacks a field."""


@dataclass
class Take:
    """Numbers of one type that lie side by side, and the paths they are wanted for.

    They, like all that the other steps read, lie `ahead` bytes behind the position, which itself
    moves only where it must: by what a message says.
    """

    dtype: str
    paths: list[str]
    ahead: int

    def goes_on_with(self, dtype: str, ahead: int) -> bool:
        """Whether a number lies beside the last of these and is of their type."""
        return (self.dtype, self.ahead + int(dtype[1]) * len(self.paths)) == (dtype, ahead)


@dataclass
class Align:
    """The position goes on, then up to a multiple."""

    add: int
    mask: int


@dataclass
class Text:
    """A length, by which the position goes on; the path is empty when the text is not wanted."""

    path: str
    ahead: int


@dataclass
class Numbers:
    """A sequence of numbers, passed over: the position goes behind it."""

    ahead: int
    size: int


@dataclass
class Steps:
    """What is done one after the other, and how far the position is behind at the end."""

    each: list[Take | Align | Text | Numbers | Repeat] = field(default_factory=list)
    ahead: int = 0


@dataclass
class Repeat:
    """A sequence of anything else: the position goes to each element in turn, then behind all."""

    path: str
    ahead: int
    steps: Steps


def compiled(store: Typestore, kind: str, wanted: Sequence[str]) -> Steps:
    """The steps through a message.

    Args:
        store: holds the definition.
        kind: type of the messages.
        wanted: paths such as `header.frame_id` or `detections[].bbox.size.x`.

    Raises:
        WalkRefusedError: a field is not there, or the definition holds what CDR walks do not.
    """
    compiler = _Compiler(store, frozenset(wanted))
    compiler.struct(kind, "")
    missing = set(wanted) - compiler.found
    if missing:
        raise WalkRefusedError(f"no field {', '.join(sorted(missing))}")
    return compiler.steps


class _Compiler:
    """Definition to steps; keeps what is known of the alignment."""

    def __init__(self, store: Typestore, wanted: frozenset[str]) -> None:
        self._store, self._wanted = store, wanted
        self._modulus, self._remainder = _WIDEST, 0
        self.steps = Steps()
        self.found: set[str] = set()

    def struct(self, kind: str, prefix: str) -> None:
        for name, (node, argument) in self._store.fielddefs[kind][1]:
            self._field(node, argument, f"{prefix}{name}")

    def _field(self, node: Any, argument: Any, path: str) -> None:
        if node == Nodetype.NAME:
            self.struct(argument, f"{path}.")
        elif node == Nodetype.BASE:
            self._base(argument[0], path)
        elif node == Nodetype.ARRAY:
            (inner, inner_argument), count = argument
            for _ in range(count):
                self._field(inner, inner_argument, f"{path}[]")
        else:
            self._sequence(argument[0], path)

    def _base(self, kind: str, path: str) -> None:
        if kind == "string":
            self._to(LENGTH_BYTES)
            self.steps.each.append(Text(self._found(path), self.steps.ahead))
            self.steps.ahead += LENGTH_BYTES
            self._modulus, self._remainder = 1, 0
        elif kind in _DTYPES:
            self._number(_DTYPES[kind], path)
        else:
            raise WalkRefusedError(f"values of type {kind}")

    def _number(self, dtype: str, path: str) -> None:
        size = int(dtype[1])
        self._to(size)
        if self._found(path):
            last = self.steps.each[-1] if self.steps.each else None
            if isinstance(last, Take) and last.goes_on_with(dtype, self.steps.ahead):
                last.paths.append(path)
            else:
                self.steps.each.append(Take(dtype, [path], self.steps.ahead))
        self._skip(size)

    def _sequence(self, item: Any, path: str) -> None:
        self._to(LENGTH_BYTES)
        node, argument = item
        if node == Nodetype.BASE and argument[0] in _DTYPES:
            self.steps.each.append(Numbers(self.steps.ahead, int(_DTYPES[argument[0]][1])))
        else:
            outer, self.steps = self.steps, Steps()
            # The first element may lie anywhere that the ones before leave it.
            self._modulus, self._remainder = 1, 0
            self._field(node, argument, f"{path}[]")
            outer.each.append(Repeat(path, outer.ahead, self.steps))
            self.steps = outer
        self.steps.ahead = 0
        self._modulus, self._remainder = 1, 0

    def _found(self, path: str) -> str:
        """The path when it is wanted, else nothing."""
        if path not in self._wanted:
            return ""
        if path in self.found:
            raise WalkRefusedError(f"{path} is in a fixed array")
        self.found.add(path)
        return path

    def _to(self, multiple: int) -> None:
        if self._modulus >= multiple:
            self._skip(-self._remainder % multiple)
        else:
            self.steps.each.append(Align(self.steps.ahead + multiple - 1, -multiple))
            self.steps.ahead = 0
            self._modulus, self._remainder = multiple, 0

    def _skip(self, count: int) -> None:
        self.steps.ahead += count
        self._remainder = (self._remainder + count) % self._modulus
