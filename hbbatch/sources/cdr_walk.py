"""Chosen fields of many CDR messages at once, without making an object of any message.

The walk is compiled from the definition that the log embeds, so it holds for exactly that layout.
It steps all messages of a batch together: where one message has a string, all have one, and their
lengths are one gather from the buffer. A message that does not fit makes the walk refuse the whole
batch, which is then read message by message.

CDR: plain, little endian, alignment relative to the byte behind the four of the encapsulation
(OMG DDSI-RTPS, version 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from hbbatch.sources.base import IntArray, Names
from hbbatch.sources.blocks import Payloads, gather

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
_HEAD: Final = 4
_WIDEST: Final = 8
_LONGEST_TEXT: Final = 256
_MOST_ELEMENTS: Final = 4096
_FEW_KINDS: Final = 16


class WalkRefusedError(Exception):
    """The walk is not for these messages, or the definition lacks a field."""


@dataclass
class _Take:
    """Numbers of one type that lie side by side, and the paths they are wanted for."""

    dtype: str
    paths: list[str]


@dataclass
class _Skip:
    """A fixed number of bytes."""

    count: int


@dataclass
class _Align:
    """Forward to a multiple."""

    to: int


@dataclass
class _Text:
    """A string; the path is empty when it is not wanted."""

    path: str


@dataclass
class _Repeat:
    """A sequence of anything; numbers side by side are passed over at once."""

    path: str
    steps: list[Any] = field(default_factory=list)
    align: int = 1
    item_bytes: int = 0


class _Compiler:
    """Definition to steps; keeps what is known of the alignment, to merge steps."""

    def __init__(self, store: Typestore, wanted: frozenset[str]) -> None:
        self._store, self._wanted = store, wanted
        self._modulus, self._remainder = _WIDEST, 0
        self.found: set[str] = set()

    def struct(self, kind: str, prefix: str, steps: list[Any]) -> None:
        for name, (node, argument) in self._store.fielddefs[kind][1]:
            self._field(node, argument, f"{prefix}{name}", steps)

    def _field(self, node: Any, argument: Any, path: str, steps: list[Any]) -> None:
        if node == Nodetype.NAME:
            self.struct(argument, f"{path}.", steps)
        elif node == Nodetype.BASE:
            self._base(argument[0], path, steps)
        elif node == Nodetype.ARRAY:
            (inner, inner_argument), count = argument
            for _ in range(count):
                self._field(inner, inner_argument, f"{path}[]", steps)
        else:
            self._sequence(argument[0], path, steps)

    def _base(self, kind: str, path: str, steps: list[Any]) -> None:
        if kind in {"string", "wstring"}:
            if kind == "wstring":
                raise WalkRefusedError("wide strings")
            self._to(4, steps)
            wanted = path in self._wanted
            self.found |= {path} if wanted else set()
            steps.append(_Text(path if wanted else ""))
            self._modulus, self._remainder = 1, 0
            return
        if kind not in _DTYPES:
            raise WalkRefusedError(f"numbers of type {kind}")
        dtype = _DTYPES[kind]
        size = int(dtype[1])
        self._to(size, steps)
        if path in self._wanted:
            self.found.add(path)
            last = steps[-1] if steps else None
            if isinstance(last, _Take) and last.dtype == dtype:
                last.paths.append(path)
            else:
                steps.append(_Take(dtype, [path]))
        else:
            self._skip(size, steps)
        self._remainder = (self._remainder + size) % self._modulus

    def _sequence(self, item: Any, path: str, steps: list[Any]) -> None:
        self._to(4, steps)
        node, argument = item
        repeat = _Repeat(path)
        if node == Nodetype.BASE and argument[0] in _DTYPES:
            size = int(_DTYPES[argument[0]][1])
            repeat.align, repeat.item_bytes = size, size
        else:
            # The first element may lie anywhere that the ones before leave it.
            self._modulus, self._remainder = 1, 0
            self._field(node, argument, f"{path}[]", repeat.steps)
        steps.append(repeat)
        self._modulus, self._remainder = 1, 0

    def _to(self, multiple: int, steps: list[Any]) -> None:
        if self._modulus >= multiple:
            self._skip(-self._remainder % multiple, steps)
            self._remainder += -self._remainder % multiple
        else:
            steps.append(_Align(multiple))
            self._modulus, self._remainder = multiple, 0

    @staticmethod
    def _skip(count: int, steps: list[Any]) -> None:
        if not count:
            return
        if steps and isinstance(steps[-1], _Skip):
            steps[-1].count += count
        else:
            steps.append(_Skip(count))


@dataclass
class Columns:
    """Fields of a batch of messages.

    Attributes:
        counts: by path of a sequence, elements a parent; parents are messages or elements.
        numbers: by path, a value a message or element, in order.
        texts: by path, a text a message or element, in order.
        parents: by path of a sequence within a sequence, the parent of each element.
    """

    counts: dict[str, IntArray]
    numbers: dict[str, NDArray[Any]]
    texts: dict[str, Names]
    parents: dict[str, IntArray]

    def stack(self, paths: Sequence[str]) -> NDArray[np.float64]:
        """Several numeric columns side by side, `(n, len(paths))`."""
        columns = [self.numbers[path] for path in paths]
        stacked = np.empty((len(columns), len(columns[0])))
        for number, column in enumerate(columns):
            stacked[number] = column
        return stacked.T


class CdrWalk:
    """The walk for one message type and a choice of its fields."""

    def __init__(self, store: Typestore, kind: str, wanted: Sequence[str]) -> None:
        """Compile.

        Args:
            store: holds the definition.
            kind: type of the messages.
            wanted: paths such as `header.frame_id` or `detections[].bbox.size.x`.

        Raises:
            WalkRefusedError: a field is not there, or the definition holds what CDR walks do not.
        """
        compiler = _Compiler(store, frozenset(wanted))
        self._steps: list[Any] = []
        compiler.struct(kind, "", self._steps)
        missing = set(wanted) - compiler.found
        if missing:
            raise WalkRefusedError(f"no field {', '.join(sorted(missing))}")

    def read(self, messages: Payloads) -> Columns:
        """The chosen fields of messages.

        Raises:
            WalkRefusedError: not all of them are as the definition says.
        """
        _check_encapsulation(messages)
        run = _Run(messages.buffer)
        try:
            origin = messages.starts + _HEAD
            start = np.zeros(len(messages), dtype=np.int64)
            end = run.steps(self._steps, _Group(origin, np.arange(len(messages))), start)
            left = messages.ends - origin - end
            if ((left < 0) | (left >= _HEAD)).any():
                raise WalkRefusedError("the size differs")
            return run.columns(len(messages))
        except IndexError as error:
            raise WalkRefusedError("reaches beyond the messages") from error


def _check_encapsulation(messages: Payloads) -> None:
    if not len(messages) or (messages.ends - messages.starts).min() < _HEAD:
        raise WalkRefusedError("no encapsulation")
    heads = gather(messages.buffer, messages.starts, np.dtype("<u4"))
    if ((heads & 0xFFFF) != 0x0100).any():
        raise WalkRefusedError("not plain little endian CDR")


class _Group(NamedTuple):
    """Messages that go through steps together; several may be of one owner.

    Attributes:
        origin: `(n,)` where each message begins in the buffer, behind its encapsulation.
        owner: `(n,)` which message or element each is.
    """

    origin: IntArray
    owner: IntArray

    def take(self, rows: IntArray) -> _Group:
        return _Group(self.origin[rows], self.owner[rows])


class _Run:
    """One batch on its way through the steps.

    Positions are relative to the origin of the message, as alignment is. What is wanted is only
    marked on the way, and gathered from the buffer at the end, all turns at once.
    """

    def __init__(self, buffer: bytes | memoryview) -> None:
        self._buffer = buffer
        self._numbers: dict[tuple[str, ...], list[tuple[IntArray, IntArray]]] = {}
        self._dtypes: dict[tuple[str, ...], str] = {}
        self._texts: dict[str, list[tuple[IntArray, IntArray, IntArray]]] = {}
        self._counts: dict[str, list[tuple[IntArray, IntArray]]] = {}
        # Seen as lengths at every place, aligned or not: as `blocks.gather`, made once.
        self._lengths = np.ndarray((len(buffer) - _HEAD + 1,), "V4", buffer, strides=(1,))

    def steps(self, steps: Sequence[Any], group: _Group, position: IntArray) -> IntArray:
        """Take steps with all of a group; positions before and after."""
        for step in steps:
            if isinstance(step, _Skip):
                position = position + step.count
            elif isinstance(step, _Align):
                position = (position + (step.to - 1)) & -step.to
            elif isinstance(step, _Take):
                position = self._take(step, group, position)
            elif isinstance(step, _Text):
                position = self._text(step, group, position)
            else:
                position = self._repeat(step, group, position)
        return position

    def _take(self, step: _Take, group: _Group, position: IntArray) -> IntArray:
        paths = tuple(step.paths)
        self._dtypes[paths] = step.dtype
        self._numbers.setdefault(paths, []).append((group.owner, group.origin + position))
        return position + int(step.dtype[1]) * len(paths)

    def _length(self, place: IntArray) -> IntArray:
        lengths: IntArray = self._lengths[place].view("<u4").astype(np.int64)
        return lengths

    def _text(self, step: _Text, group: _Group, position: IntArray) -> IntArray:
        place = group.origin + position
        length = self._length(place)
        if step.path:
            self._texts.setdefault(step.path, []).append((group.owner, place + _HEAD, length))
        return position + _HEAD + length

    def _repeat(self, step: _Repeat, group: _Group, position: IntArray) -> IntArray:
        counts, position = self._length(group.origin + position), position + _HEAD
        if step.item_bytes:
            aligned = (position + (step.align - 1)) & -step.align
            return np.where(counts > 0, aligned + counts * step.item_bytes, position)
        most = int(counts.max(initial=0))
        if most > _MOST_ELEMENTS:
            raise WalkRefusedError("too many elements")
        self._counts.setdefault(step.path, []).append((group.owner, counts))
        # Elements of a sequence of messages are numbered through; those of a sequence within a
        # sequence carry the number of their parent.
        nested = "[]" in step.path
        first = group.owner if nested else np.cumsum(counts) - counts
        least = int(counts.min()) if len(counts) else 0
        for turn in range(most):
            owner = first if nested else first + turn
            if turn < least:
                position = self.steps(step.steps, group._replace(owner=owner), position)
                continue
            active = np.flatnonzero(counts > turn)
            position[active] = self.steps(
                step.steps, _Group(group.origin, owner).take(active), position[active]
            )
        return position

    def columns(self, messages: int) -> Columns:
        """What was marked, in order."""
        counts = {path: _Order()(pieces) for path, pieces in self._counts.items()}
        if any(len(n) != messages for path, n in counts.items() if "[]" not in path):
            raise WalkRefusedError("a sequence within a fixed array")
        orders: dict[str, _Order] = {}

        def ordered(path: str, pieces: list[tuple[IntArray, IntArray]]) -> IntArray:
            sequence = path.rpartition("[]")[0]
            return orders.setdefault(sequence, _Order())(pieces)

        numbers = {}
        for paths, pieces in self._numbers.items():
            block = self._gather(ordered(paths[0], pieces), self._dtypes[paths], len(paths))
            numbers.update({path: block[:, column] for column, path in enumerate(paths)})
        texts = {}
        for path, places in self._texts.items():
            if all(int(length.max(initial=0)) <= 1 for _, _, length in places):
                count = sum(len(owner) for owner, _, _ in places)
                texts[path] = Names(np.zeros(count, dtype=np.int64), ("",))
                continue
            start = ordered(path, [(owner, place) for owner, place, _ in places])
            length = ordered(path, [(owner, length) for owner, _, length in places])
            texts[path] = self._names(start, length)
        parents = {path: order.owners for path, order in orders.items()}
        return Columns(counts, numbers, texts, parents)

    def _gather(self, places: IntArray, dtype: str, count: int) -> NDArray[Any]:
        """Numbers that lie side by side, `(n, count)`."""
        rows: NDArray[Any] = gather(self._buffer, places, np.dtype((f"<{dtype}", (count,))))
        return rows

    def _names(self, start: IntArray, length: IntArray) -> Names:
        letters = np.maximum(length - 1, 0)  # a zero byte ends them
        longest = int(letters.max(initial=0))
        if longest > _LONGEST_TEXT:
            raise WalkRefusedError("a long text")
        words = self._gather(start, "u8", -(-longest // _WIDEST))
        words &= _masks(words.shape[1]).take(letters, axis=0)
        first, codes = _distinct(words)
        try:
            vocabulary = tuple(words[row].tobytes().rstrip(b"\0").decode() for row in first)
        except UnicodeDecodeError as error:
            raise WalkRefusedError("a text is not UTF-8") from error
        return Names(codes, vocabulary)


def _masks(words: int) -> NDArray[np.uint64]:
    """By number of letters, which bits of some words hold them, `(8 * words + 1, words)`."""
    letters = np.arange(words * _WIDEST)
    kept = np.arange(words * _WIDEST + 1)[:, None] > letters
    return (kept * np.uint8(0xFF)).view("<u8")


def _distinct(rows: NDArray[np.uint64]) -> tuple[list[int], IntArray]:
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


class _Order:
    """Puts what was taken turn by turn in the order of its owners.

    All fields of the elements of a sequence are taken in the same turns: what is worked out for the
    first serves the others.
    """

    def __init__(self) -> None:
        self.owners: IntArray = np.zeros(0, dtype=np.int64)
        self._order: IntArray | None = None

    def __call__(self, pieces: list[tuple[IntArray, IntArray]]) -> IntArray:
        values = np.concatenate([value for _, value in pieces])
        if not len(self.owners):
            self.owners = np.concatenate([owner for owner, _ in pieces])
            if not (np.diff(self.owners) >= 0).all():
                self._order = _sorting(self.owners)
                self.owners = self.owners[self._order]
        return values if self._order is None else values[self._order]


def _sorting(owners: IntArray) -> IntArray:
    """What sorts the owners, those that are equal as they came."""
    count = len(owners)
    if int(owners.max()) == count - 1:
        order = np.full(count, -1, dtype=np.int64)
        order[owners] = np.arange(count)
        if order.min() >= 0:
            # Each number once: no sorting needed.
            return order
    return np.argsort(owners, kind="stable")
