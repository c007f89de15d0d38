"""Chosen fields of many CDR messages at once, without making an object of any message.

The walk is compiled from the definition that the log embeds (`cdr_steps`), so it holds for exactly
that layout. It steps all messages of a batch together: where one message has a string, all have
one, and their lengths are one gather from the buffer. A message that does not fit makes the walk
refuse the whole batch, which is then read message by message.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.store import Typestore

from hbbatch.sources.base import IntArray, Names
from hbbatch.sources.blocks import Payloads, everywhere, gather
from hbbatch.sources.cdr_steps import (
    LENGTH_BYTES,
    Align,
    Numbers,
    Repeat,
    Steps,
    Take,
    Text,
    WalkRefusedError,
    compiled,
)
from hbbatch.sources.cdr_texts import WORD_LETTERS, distinct, masks

_HEAD: Final = 4
_LENGTH: Final = np.dtype("<u4")
_LONGEST_TEXT: Final = 256
_MOST_ELEMENTS: Final = 4096


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
        """Compile; arguments and errors as of `cdr_steps.compiled`."""
        self._steps = compiled(store, kind, wanted)

    def read(self, messages: Payloads) -> Columns:
        """The chosen fields of messages.

        Raises:
            WalkRefusedError: not all of them are as the definition says.
        """
        _check_encapsulation(messages)
        run = _Run(messages.buffer)
        try:
            group = _Group(messages.starts + _HEAD, np.arange(len(messages)))
            position = np.zeros(len(messages), dtype=np.int64)
            run.go(self._steps, group, position)
            left = messages.ends - group.origin - position
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


class _Marked(NamedTuple):
    """Numbers to be gathered.

    Attributes:
        dtype: of each.
        ahead: bytes from the places to them.
        pieces: owners and places, turn by turn.
    """

    dtype: str
    ahead: int
    pieces: list[tuple[IntArray, IntArray]]


class _Run:
    """One batch on its way through the steps.

    Positions are relative to the origin of the message, as alignment is, and change in place. What
    is wanted is only marked on the way, and gathered from the buffer at the end, all turns at once.
    """

    def __init__(self, buffer: bytes | memoryview) -> None:
        self._buffer = buffer
        self._numbers: dict[tuple[str, ...], _Marked] = {}
        self._texts: dict[str, list[tuple[IntArray, IntArray, NDArray[np.uint32]]]] = {}
        self._counts: dict[str, list[tuple[IntArray, IntArray]]] = {}
        self._lengths: dict[int, NDArray[np.void]] = {}

    def go(self, steps: Steps, group: _Group, position: IntArray) -> None:
        """Take steps with all of a group."""
        for step in steps.each:
            if isinstance(step, Align):
                position += step.add
                position &= step.mask
            elif isinstance(step, Take):
                marked = _Marked(step.dtype, step.ahead, [])
                pieces = self._numbers.setdefault(tuple(step.paths), marked).pieces
                pieces.append((group.owner, group.origin + position))
            elif isinstance(step, Text):
                place = group.origin + position
                length = self._length(place, step.ahead)
                if step.path:
                    place += step.ahead + LENGTH_BYTES
                    self._texts.setdefault(step.path, []).append((group.owner, place, length))
                position += length
            elif isinstance(step, Numbers):
                self._numbers_passed(step, group, position)
            else:
                self._repeat(step, group, position)
        if steps.ahead:
            position += steps.ahead

    def _length(self, place: IntArray, ahead: int) -> NDArray[np.uint32]:
        """The lengths that lie some bytes behind places."""
        if ahead not in self._lengths:
            self._lengths[ahead] = everywhere(self._buffer, _LENGTH, ahead)
        return self._lengths[ahead][place].view(_LENGTH)

    def _numbers_passed(self, step: Numbers, group: _Group, position: IntArray) -> None:
        count = self._length(group.origin + position, step.ahead).astype(np.int64)
        position += step.ahead + LENGTH_BYTES
        aligned = (position + (step.size - 1)) & -step.size
        position[:] = np.where(count > 0, aligned + count * step.size, position)

    def _repeat(self, step: Repeat, group: _Group, position: IntArray) -> None:
        counts = self._length(group.origin + position, step.ahead).astype(np.int64)
        position += step.ahead + LENGTH_BYTES
        self._counts.setdefault(step.path, []).append((group.owner, counts))
        alive = _alive(counts)
        # Elements of a sequence of messages are numbered through; those of a sequence within a
        # sequence carry the number of their parent.
        nested = "[]" in step.path
        owner = group.owner if nested else np.cumsum(counts) - counts
        if not alive or alive[-1] == len(counts):
            self._turns(step, _Group(group.origin, owner), position, alive, nested)
            return
        # Those with most elements first: who still has one is then a slice.
        order = np.argsort(-counts, kind="stable")
        moved = position[order]
        ordered = _Group(group.origin[order], owner[order])
        self._turns(step, ordered, moved, alive, nested)
        position[order] = moved

    def _turns(
        self, step: Repeat, group: _Group, position: IntArray, alive: list[int], nested: bool
    ) -> None:
        """The elements of a group, the first of each message, then the second."""
        for turn, count in enumerate(alive):
            owner = group.owner[:count]
            part = _Group(group.origin[:count], owner if nested else owner + turn)
            self.go(step.steps, part, position[:count])

    def columns(self, messages: int) -> Columns:
        """What was marked, in order."""
        counts = {path: _Order()(pieces) for path, pieces in self._counts.items()}
        if any(len(n) != messages for path, n in counts.items() if "[]" not in path):
            raise WalkRefusedError("a sequence within a fixed array")
        orders: dict[str, _Order] = {}

        def ordered(path: str, pieces: Sequence[tuple[IntArray, NDArray[Any]]]) -> NDArray[Any]:
            sequence = path.rpartition("[]")[0]
            return orders.setdefault(sequence, _Order())(pieces)

        numbers = {}
        for paths, (dtype, ahead, pieces) in self._numbers.items():
            block = self._gather(ordered(paths[0], pieces), dtype, len(paths), ahead)
            numbers.update({path: block[:, column] for column, path in enumerate(paths)})
        texts = {}
        for path, places in self._texts.items():
            if all(int(length.max(initial=0)) <= 1 for _, _, length in places):
                count = sum(len(owner) for owner, _, _ in places)
                texts[path] = Names(np.zeros(count, dtype=np.int64), ("",))
                continue
            start = ordered(path, [(owner, place) for owner, place, _ in places])
            length = ordered(path, [(owner, length) for owner, _, length in places])
            texts[path] = self._names(start, length.astype(np.int64))
        parents = {path: order.owners for path, order in orders.items()}
        return Columns(counts, numbers, texts, parents)

    def _gather(self, places: IntArray, dtype: str, count: int, ahead: int = 0) -> NDArray[Any]:
        """Numbers that lie side by side some bytes behind places, `(n, count)`."""
        kind = np.dtype((f"<{dtype}", (count,)))
        rows: NDArray[Any] = gather(self._buffer, places, kind, ahead)
        return rows

    def _names(self, start: IntArray, length: IntArray) -> Names:
        letters = np.maximum(length - 1, 0)  # a zero byte ends them
        longest = int(letters.max(initial=0))
        if longest > _LONGEST_TEXT:
            raise WalkRefusedError("a long text")
        words = self._gather(start, "u8", -(-longest // WORD_LETTERS))
        words &= masks(words.shape[1]).take(letters, axis=0)
        first, codes = distinct(words)
        try:
            vocabulary = tuple(words[row].tobytes().rstrip(b"\0").decode() for row in first)
        except UnicodeDecodeError as error:
            raise WalkRefusedError("a text is not UTF-8") from error
        return Names(codes, vocabulary)


def _alive(counts: IntArray) -> list[int]:
    """How many have a first element, a second, and so on."""
    most = int(counts.max(initial=0))
    if most > _MOST_ELEMENTS:
        raise WalkRefusedError("too many elements")
    if most == counts.min(initial=most):
        return [len(counts)] * most
    ended: list[int] = np.cumsum(np.bincount(counts)[:most]).tolist()
    return [len(counts) - number for number in ended]


class _Order:
    """Puts what was taken turn by turn in the order of its owners.

    All fields of the elements of a sequence are taken in the same turns: what is worked out for the
    first serves the others.
    """

    def __init__(self) -> None:
        self.owners: IntArray = np.zeros(0, dtype=np.int64)
        self._order: IntArray | None = None

    def __call__(self, pieces: Sequence[tuple[IntArray, NDArray[Any]]]) -> NDArray[Any]:
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
