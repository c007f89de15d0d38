"""Recorded messages in blocks: many messages in one buffer, so that they can be read together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from hbbatch.sources.base import Findings, IntArray
from hbbatch.sources.channels import Channel, RawMessage, Wanted

_BLOCK_MESSAGES: Final = 4096
_BLOCK_BYTES: Final = 8 * 2**20


def gather(data: bytes | memoryview, places: IntArray, kind: np.dtype[Any]) -> Any:
    """Values that lie at any places of a buffer, aligned or not, `(n,)`.

    They are copied as bytes of no type, which is much faster than as numbers.

    Raises:
        IndexError: one reaches beyond the buffer.
    """
    shape = (max(len(data) - kind.itemsize + 1, 0),)
    everywhere = np.ndarray(shape, f"V{kind.itemsize}", data, strides=(1,))
    return everywhere[places].view(kind)


@dataclass(frozen=True)
class Payloads:
    """The bytes of m messages.

    Attributes:
        buffer: holds them all.
        starts: `(m,)` where each begins.
        ends: `(m,)` where each ends.
    """

    buffer: bytes | memoryview
    starts: IntArray
    ends: IntArray

    @classmethod
    def of(cls, messages: Sequence[bytes]) -> Payloads:
        """From messages that lie apart."""
        sizes = np.array([len(message) for message in messages], dtype=np.int64)
        ends = np.cumsum(sizes)
        return cls(b"".join(messages), ends - sizes, ends)

    def __len__(self) -> int:
        return len(self.starts)

    def __getitem__(self, rows: IntArray) -> Payloads:
        return Payloads(self.buffer, self.starts[rows], self.ends[rows])

    def __iter__(self) -> Iterator[bytes]:
        view = memoryview(self.buffer)
        for start, end in zip(self.starts.tolist(), self.ends.tolist(), strict=True):
            yield bytes(view[start:end])


@dataclass(frozen=True)
class Block:
    """Messages as they follow one another in a log.

    Readers of a log may use the buffer again: a block holds until the next one is drawn.

    Attributes:
        channels: those that the messages are of, and maybe others.
        codes: `(m,)` index into the channels.
        log_time_ns: `(m,)` when the recorder received them.
        payloads: m messages.
    """

    channels: Sequence[Channel]
    codes: IntArray
    log_time_ns: IntArray
    payloads: Payloads

    def messages(self) -> Iterator[RawMessage]:
        """The messages one by one, their bytes copied."""
        heads = zip(self.codes.tolist(), self.log_time_ns.tolist(), self.payloads, strict=True)
        return (RawMessage(self.channels[code], time_ns, data) for code, time_ns, data in heads)


class MessageLog(Protocol):
    """A container of messages."""

    @property
    def path(self) -> Path:
        """The file or folder."""
        ...

    @property
    def format_name(self) -> str:
        """Name of the format, for the catalogue."""
        ...

    def profile(self) -> str:
        """What the container says of the system it was recorded on; empty when nothing.

        Raises:
            OSError: the file cannot be read.
        """
        ...

    def channels(self, findings: Findings) -> Sequence[Channel]:
        """All channels, those without messages included; damage goes to the findings.

        Raises:
            OSError: the file cannot be read.
        """
        ...

    def blocks(self, wanted: Wanted, findings: Findings) -> Iterator[Block]:
        """Messages of the wanted channels as they lie in the file; damage goes to the findings.

        A block holds until the next one is drawn.

        Raises:
            OSError: the file cannot be read.
        """
        ...

    def fingerprint(self) -> str:
        """Hash of the content.

        Raises:
            OSError: the file cannot be read.
        """
        ...


def in_blocks(messages: Iterator[RawMessage]) -> Iterator[Block]:
    """Messages that are read one by one, in blocks."""
    waiting: list[RawMessage] = []
    size = 0
    for message in messages:
        waiting.append(message)
        size += len(message.data)
        if len(waiting) >= _BLOCK_MESSAGES or size >= _BLOCK_BYTES:
            yield _block(waiting)
            waiting, size = [], 0
    if waiting:
        yield _block(waiting)


def _block(messages: Sequence[RawMessage]) -> Block:
    # Channels by identity: comparing them costs more than taking a message.
    channels = {id(message.channel): message.channel for message in messages}
    numbers = {identity: number for number, identity in enumerate(channels)}
    return Block(
        channels=list(channels.values()),
        codes=np.array([numbers[id(message.channel)] for message in messages], dtype=np.int64),
        log_time_ns=np.array([message.log_time_ns for message in messages], dtype=np.int64),
        payloads=Payloads.of([message.data for message in messages]),
    )


def _unset(size: int) -> memoryview:
    """Memory that costs nothing before it is written to."""
    return np.empty(size, dtype=np.uint8).data


class BlockBuilder:
    """Collects messages that lie together in larger pieces into blocks, in a buffer of its own."""

    def __init__(self, capacity: int = _BLOCK_BYTES) -> None:
        self._capacity = capacity
        self._buffer = _unset(0)
        self._used = 0
        self._parts: list[tuple[IntArray, IntArray, IntArray, IntArray]] = []

    def fits(self, size: int) -> bool:
        """Whether a piece of a size can be added before a block is taken out."""
        return not self._parts or self._used + size <= self._capacity

    def add(
        self,
        piece: bytes | memoryview,
        starts: IntArray,
        ends: IntArray,
        codes: IntArray,
        log_time_ns: IntArray,
    ) -> None:
        """Take messages.

        Args:
            piece: they lie in it, among others.
            starts: `(m,)` where each begins.
            ends: `(m,)` where each ends.
            codes: `(m,)` the number of the channel.
            log_time_ns: `(m,)`.
        """
        sizes = ends - starts
        # One copy of all is cheaper than many small ones, unless most of it is of no use.
        if 2 * int(sizes.sum()) < len(piece):
            view = memoryview(piece)
            spans = zip(starts.tolist(), ends.tolist(), strict=True)
            piece = b"".join([view[start:end] for start, end in spans])
            ends = np.cumsum(sizes)
            starts = ends - sizes
        first, self._used = self._used, self._used + len(piece)
        needed = max(self._used, self._capacity)
        if len(self._buffer) < needed:
            former, self._buffer = self._buffer, _unset(needed)
            self._buffer[:first] = former[:first]
        self._buffer[first : self._used] = piece
        self._parts.append((starts + first, ends + first, codes, log_time_ns))

    def take(self, channels: Sequence[Channel]) -> Iterator[Block]:
        """What was added, as a block; none when nothing was."""
        if self._parts:
            starts, ends, codes, log_time_ns = map(np.concatenate, zip(*self._parts, strict=True))
            self._parts, self._used = [], 0
            yield Block(channels, codes, log_time_ns, Payloads(self._buffer, starts, ends))
            if len(self._buffer) > self._capacity:
                self._buffer = _unset(0)
