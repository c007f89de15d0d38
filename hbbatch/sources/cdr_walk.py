"""Chosen fields of many CDR messages at once, without making an object of any message.

The walk is compiled from the definition that the log embeds (`cdr_steps`), so it holds for exactly
that layout. It steps all messages of a batch together: where one message has a string, all have
one, and their lengths are one gather from the buffer. A message that does not fit makes the walk
refuse the whole batch, which is then read message by message.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
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
from hbbatch.sources.cdr_texts import WORD_LETTERS, texts_of

_HEAD: Final = 4
_LENGTH: Final = np.dtype("<u4")
_LONGEST_TEXT: Final = 256
_MOST_ELEMENTS: Final = 4096


@dataclass
class Columns:
    """Fields of a batch of messages.

    Attributes:
        counts: by path of a sequence of the messages, elements a message.
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
            return run.columns()
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

    def first(self, count: int) -> _Group:
        """Some of them, from the first on."""
        return _Group(self.origin[:count], self.owner[:count])


@dataclass
class _Marked:
    """Numbers to be gathered, turn by turn.

    Attributes:
        dtype: of each.
        ahead: bytes from the places to them.
        owners: whose they are.
        places: where they are.
    """

    dtype: str
    ahead: int
    owners: list[IntArray] = field(default_factory=list)
    places: list[IntArray] = field(default_factory=list)


@dataclass
class _MarkedText:
    """Texts to be gathered, turn by turn.

    Attributes:
        owners: whose they are.
        places: where they begin.
        lengths: with the zero byte that ends them.
    """

    owners: list[IntArray] = field(default_factory=list)
    places: list[IntArray] = field(default_factory=list)
    lengths: list[NDArray[np.uint32]] = field(default_factory=list)


class _Run:
    """One batch on its way through the steps.

    Positions are relative to the origin of the message, as alignment is, and change in place. What
    is wanted is only marked on the way, and gathered from the buffer at the end, all turns at once.
    """

    def __init__(self, buffer: bytes | memoryview) -> None:
        self._buffer = buffer
        self._numbers: dict[tuple[str, ...], _Marked] = {}
        self._texts: dict[str, _MarkedText] = {}
        self._counts: dict[str, IntArray] = {}
        self._lengths: dict[int, NDArray[np.void]] = {}

    def go(self, steps: Steps, group: _Group, position: IntArray) -> None:
        """Take steps with all of a group."""
        for step in steps.each:
            if isinstance(step, Align):
                position += step.add
                position &= step.mask
            elif isinstance(step, Take):
                paths = tuple(step.paths)
                marked = self._numbers.setdefault(paths, _Marked(step.dtype, step.ahead))
                marked.owners.append(group.owner)
                marked.places.append(group.origin + position)
            elif isinstance(step, Text):
                self._text(step, group, position)
            elif isinstance(step, Numbers):
                self._numbers_passed(step, group, position)
            else:
                self._repeat(step, group, position)
        if steps.ahead:
            position += steps.ahead

    def _text(self, step: Text, group: _Group, position: IntArray) -> None:
        place = group.origin + position
        length = self._length(place, step.ahead)
        position += length
        if step.path:
            place += step.ahead + LENGTH_BYTES
            marked = self._texts.setdefault(step.path, _MarkedText())
            marked.owners.append(group.owner)
            marked.places.append(place)
            marked.lengths.append(length)

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
        alive = _alive(counts)
        # Elements of a sequence of messages are numbered through; those of a sequence within a
        # sequence carry the number of their parent.
        nested = "[]" in step.path
        if not nested:
            self._counts[step.path] = counts
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
            part = group if count == len(position) else group.first(count)
            if not nested:
                part = _Group(part.origin, part.owner + turn)
            self.go(step.steps, part, position[:count])

    def columns(self) -> Columns:
        """What was marked, in order."""
        orders: dict[tuple[int, ...], _Order] = {}
        parents: dict[str, IntArray] = {}

        def order(path: str, owners: Sequence[IntArray]) -> _Order:
            # What was marked in the same turns is in the same order.
            turns = tuple(map(id, owners))
            if turns not in orders:
                orders[turns] = _Order(owners)
            parents[path.rpartition("[]")[0]] = orders[turns].owners
            return orders[turns]

        numbers = {}
        for paths, marked in self._numbers.items():
            places = order(paths[0], marked.owners)(marked.places)
            block = self._gather(places, marked.dtype, len(paths), marked.ahead)
            numbers.update({path: block[:, column] for column, path in enumerate(paths)})
        texts = {}
        for path, text in self._texts.items():
            in_order = order(path, text.owners)
            texts[path] = self._names(in_order, text)
        return Columns(self._counts, numbers, texts, parents)

    def _gather(self, places: IntArray, dtype: str, count: int, ahead: int = 0) -> NDArray[Any]:
        """Numbers that lie side by side some bytes behind places, `(n, count)`."""
        kind = np.dtype((f"<{dtype}", (count,)))
        rows: NDArray[Any] = gather(self._buffer, places, kind, ahead)
        return rows

    def _names(self, order: _Order, marked: _MarkedText) -> Names:
        length = np.concatenate(marked.lengths)
        longest = int(length.max(initial=0)) - 1  # a zero byte ends them
        if longest > _LONGEST_TEXT:
            raise WalkRefusedError("a long text")
        if longest <= 0:
            return Names(np.zeros(len(length), dtype=np.int64), ("",))
        letters = np.maximum(order([length]).astype(np.int64) - 1, 0)
        words = self._gather(order(marked.places), "u8", -(-longest // WORD_LETTERS))
        try:
            return texts_of(words, letters)
        except UnicodeDecodeError as error:
            raise WalkRefusedError("a text is not UTF-8") from error


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
    """Puts what was marked turn by turn in the order of its owners.

    Attributes:
        owners: `(n,)` of everything, in that order.
    """

    def __init__(self, owners: Sequence[IntArray]) -> None:
        self.owners = np.concatenate(owners)
        self._order: IntArray | None = None
        if not (np.diff(self.owners) >= 0).all():
            self._order = _sorting(self.owners)
            self.owners = self.owners[self._order]

    def __call__(self, pieces: Sequence[NDArray[Any]]) -> NDArray[Any]:
        values = np.concatenate(pieces)
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
