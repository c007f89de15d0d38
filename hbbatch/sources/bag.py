"""ROS 1 bags, version 2.0, as containers of messages (http://wiki.ros.org/Bags/Format/2.0).

Records are read one after the other and not by the index, so that a bag that was never closed, or
is damaged, gives what it holds. A chunk that cannot be unpacked is left out as a whole; behind
broken framing the next chunk is sought.
"""

from __future__ import annotations

import bz2
import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from io import BufferedReader
from pathlib import Path
from typing import Final

from hbbatch.sources.base import Findings
from hbbatch.sources.blocks import Block, in_blocks
from hbbatch.sources.channels import (
    Channel,
    Count,
    RawMessage,
    Wanted,
    file_hash,
    starts_with,
    unpack_lz4,
)
from hbbatch.sources.messages import normalise_type

_MAGIC: Final = b"#ROSBAG V"
_VERSION: Final = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG_HEADER, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_LENGTH: Final = struct.Struct("<I")
_LARGEST_CHUNK: Final = 2**30
_SEARCH_STEP: Final = 2**24
_START_OF_CHUNK: Final = re.compile(rb"(?=.{8}compression=(?:none|bz2|lz4).{4}op=\x05)", re.DOTALL)
_DAMAGE: Final = (
    struct.error,
    ValueError,
    KeyError,
    RuntimeError,
    OSError,
    EOFError,
    MemoryError,
)
"""What unpacking raises on bytes that are not as the format says."""


def is_bag_file(path: Path) -> bool:
    """Whether a path is a file that starts as ROS 1 bags do.

    Raises:
        OSError: the file cannot be read.
    """
    return starts_with(path, _MAGIC)


@dataclass(frozen=True)
class BagLog:
    """A ROS 1 bag."""

    path: Path
    format_name: str = "rosbag1"

    def profile(self) -> str:
        """Bags know of one system only."""
        return "ros1"

    def channels(self, findings: Findings) -> Sequence[Channel]:
        """All connections, one a topic and type."""
        met: dict[Channel, None] = {}

        def remember(channel: Channel) -> bool:
            met[channel] = None
            return False

        for _ in self.blocks(remember, findings):
            pass
        return list(met)

    def blocks(self, wanted: Wanted, findings: Findings) -> Iterator[Block]:
        """Messages of the wanted channels, in blocks."""
        return in_blocks(self._messages(wanted, findings))

    def _messages(self, wanted: Wanted, findings: Findings) -> Iterator[RawMessage]:
        """Messages of the wanted connections in file order, damaged places left out."""
        reading = _Reading(wanted)
        with self.path.open("rb") as file:
            if file.readline(64) != _VERSION:
                findings.lost("the bag is not of version 2.0: convert it with `rosbag fix`")
                return
            for header, data in _records(file, reading):
                yield from reading.take(header, data)
        reading.report(findings)

    def fingerprint(self) -> str:
        """Hash of all bytes of the file."""
        return file_hash(self.path)


_Header = dict[bytes, bytes]


@dataclass
class _Reading:
    """Connections met so far and what was lost."""

    wanted: Wanted
    channels: dict[int, Channel | None] = field(default_factory=dict)
    count: Count = field(default_factory=Count)
    damage: list[str] = field(default_factory=list)
    chunks: int = 0
    declared_chunks: int = 0
    unknown: int = 0

    def take(self, header: _Header, data: memoryview) -> Iterator[RawMessage]:
        operation = header.get(b"op", b"\0")[0]
        try:
            if operation == _CHUNK:
                self.chunks += 1
                yield from self._chunk(header, data)
            elif operation == _MESSAGE:
                yield from self._message(header, data)
            elif operation == _CONNECTION:
                self._connection(header, data)
            elif operation == _CHUNK_INFO:
                self._chunk_info(header, data)
            elif operation == _BAG_HEADER:
                self.declared_chunks = _number(header[b"chunk_count"])
        except _DAMAGE as error:
            what = " ".join(str(error).split()) or type(error).__name__
            self.damage.append(f"damaged record ({what})")

    def report(self, findings: Findings) -> None:
        if self.damage:
            more = f" and {len(self.damage) - 1} more" if len(self.damage) > 1 else ""
            findings.lost(f"{self.damage[0]}{more}")
        if self.unknown:
            findings.lost(f"{self.unknown} messages lost: their connection record is missing")
        if self.count.expected is None and self.chunks:
            findings.note("the bag has no index (not closed while recording); read without")
        if self.declared_chunks > self.chunks:
            findings.lost(f"the bag declares {self.declared_chunks} chunks and holds {self.chunks}")
        self.count.report(findings, "the bag's index")

    def _chunk(self, header: _Header, data: memoryview) -> Iterator[RawMessage]:
        size = _number(header[b"size"])
        if size > _LARGEST_CHUNK:
            raise ValueError(f"a chunk claims {size} bytes")
        unpacked = _unpacked(header[b"compression"], data, size)
        for inner, content in _split(memoryview(unpacked)):
            yield from self.take(inner, content)
        if len(unpacked) != size:
            raise ValueError(f"a chunk holds {len(unpacked)} bytes of {size}")

    def _message(self, header: _Header, data: memoryview) -> Iterator[RawMessage]:
        self.count.read += 1
        connection = _number(header[b"conn"])
        if connection not in self.channels:
            self.unknown += 1
            return
        channel = self.channels[connection]
        if channel is not None:
            seconds, nanoseconds = struct.unpack("<II", header[b"time"])
            yield RawMessage(channel, seconds * 10**9 + nanoseconds, bytes(data))

    def _connection(self, header: _Header, data: memoryview) -> None:
        inner = _fields(data)
        channel = Channel(
            topic=header[b"topic"].decode(),
            message_type=normalise_type(inner[b"type"].decode()),
            message_encoding="ros1",
            schema_encoding="ros1msg",
            definition=inner[b"message_definition"],
        )
        self.channels[_number(header[b"conn"])] = channel if self.wanted(channel) else None

    def _chunk_info(self, header: _Header, data: memoryview) -> None:
        """An index entry: how many messages of each connection a chunk holds."""
        pairs = struct.unpack_from(f"<{2 * _number(header[b'count'])}I", data)
        self.count.expected = (self.count.expected or 0) + sum(pairs[1::2])


def _records(file: BufferedReader, reading: _Reading) -> Iterator[tuple[_Header, memoryview]]:
    size = file.seek(0, 2)
    position = file.seek(len(_VERSION))
    while position < size:
        try:
            header, data = _record(file, size)
        except _DAMAGE:
            following = _next_chunk(file, position + 1, size)
            if following is None:
                reading.damage.append(f"the bag ends early: nothing readable from byte {position}")
                return
            reading.damage.append(f"damaged from byte {position} to {following}")
            position = file.seek(following)
            continue
        position = file.tell()
        yield header, data


def _record(file: BufferedReader, size: int) -> tuple[_Header, memoryview]:
    """The record at the file's position.

    Raises:
        one of `_DAMAGE`: the bytes are no whole record.
    """
    header = _fields(_part(file, size))
    if header.get(b"op", b"") not in _KNOWN_OPERATIONS:
        raise ValueError("not a record")
    return header, _part(file, size)


_KNOWN_OPERATIONS: Final = tuple(bytes([n]) for n in range(_MESSAGE, _CONNECTION + 1))


def _part(file: BufferedReader, size: int) -> memoryview:
    (length,) = _LENGTH.unpack(file.read(4))
    if length > size - file.tell():
        raise ValueError("reaches beyond the end of the file")
    return memoryview(file.read(length))


def _split(data: memoryview) -> Iterator[tuple[_Header, memoryview]]:
    """Records of a chunk, up to the last whole one."""
    position = 0
    while position + 8 <= len(data):
        (length,) = _LENGTH.unpack_from(data, position)
        header = data[position + 4 : position + 4 + length]
        position += 4 + length
        (length,) = _LENGTH.unpack_from(data, position)
        content = data[position + 4 : position + 4 + length]
        position += 4 + length
        if position > len(data):
            raise ValueError("a record reaches beyond its chunk")
        yield _fields(header), content


def _fields(data: memoryview) -> _Header:
    """`name=value` fields of a header."""
    fields: _Header = {}
    position, content = 0, bytes(data)
    while position + 4 <= len(content):
        (length,) = _LENGTH.unpack_from(content, position)
        position += 4
        if position + length > len(content):
            raise ValueError("a field reaches beyond its header")
        name, _, value = content[position : position + length].partition(b"=")
        fields[name] = value
        position += length
    return fields


def _number(value: bytes) -> int:
    return int.from_bytes(value, "little")


def _unpacked(compression: bytes, data: memoryview, size: int) -> bytes:
    """The records of a chunk; of a chunk without end, its start."""
    if compression == b"none":
        return bytes(data)
    if compression == b"bz2":
        return bz2.BZ2Decompressor().decompress(data, max_length=size)
    if compression == b"lz4":
        return unpack_lz4(data, size)
    raise ValueError(f"a chunk is packed with {compression.decode(errors='replace')!r}")


def _next_chunk(file: BufferedReader, start: int, size: int) -> int | None:
    while start < size:
        file.seek(start)
        block = file.read(_SEARCH_STEP)
        match = _START_OF_CHUNK.search(block)
        if match is not None:
            return start + match.start()
        start += max(len(block) - 64, 64)
    return None
