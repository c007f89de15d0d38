"""Records of an MCAP file in file order, past damage (https://mcap.dev/spec).

A record is an opcode (1 byte), a length (8 bytes) and its content. Where that framing breaks, the
next place is sought from which several records follow one another; a chunk that does not hold what
its checksum says is left out as a whole.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BufferedReader
from typing import Final

import numpy as np
import zstandard
from numpy.typing import NDArray
from zlib_ng.zlib_ng import crc32

from hbbatch.sources.base import Findings, IntArray
from hbbatch.sources.channels import unpack_lz4

Content = bytes | memoryview

MAGIC: Final = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = range(1, 8)
ATTACHMENT, STATISTICS, DATA_END = 9, 11, 15

_FRAME: Final = struct.Struct("<BQ")
_LENGTH: Final = struct.Struct("<xQ")
_CHUNK_HEAD: Final = struct.Struct("<QQQII")
_KEPT: Final = {HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, STATISTICS}
_LARGEST_CHUNK: Final = 2**30
_LARGEST_RUN: Final = 2**20
_PIECE: Final = 2**20
_SEARCH_STEP: Final = 2**24
_MOST_CANDIDATES: Final = 200_000
_LINKS: Final = 3
_ZSTD: Final = zstandard.ZstdDecompressor()
_START_OF_RECORD: Final = re.compile(rb"(?=[\x01-\x0f].{5}\x00\x00\x00)", re.DOTALL)


class DamagedRecordError(Exception):
    """Bytes that are not as the specification says."""


@dataclass
class Damage:
    """What was met of a file that is not as the specification says.

    Attributes:
        places: how often.
        first: what the first was.
        after_chunk: whether the last chunk was left out, whose index then says what it held.
        messages: messages known to be lost with their chunks.
    """

    places: int = 0
    first: str = ""
    after_chunk: bool = False
    messages: int = 0

    def add(self, what: str) -> None:
        """Record a place."""
        self.places += 1
        self.first = self.first or what

    def report(self, findings: Findings) -> None:
        """Write it down, as one line."""
        if not self.places:
            return
        more = f" and {self.places - 1} more" if self.places > 1 else ""
        lost = f": {self.messages} messages of damaged chunks lost" if self.messages else ""
        findings.lost(f"{self.first}{more}{lost}")


@dataclass(frozen=True)
class Run:
    """n records that lie one after the other.

    Attributes:
        data: holds them.
        opcodes: `(n,)`.
        starts: `(n,)` where the content of each begins in the data.
        ends: `(n,)` where it ends.
        whole: false when a record behind them reaches beyond the end of the data.
    """

    data: Content
    opcodes: NDArray[np.uint8]
    starts: IntArray
    ends: IntArray
    whole: bool

    @classmethod
    def of(cls, data: Content) -> Run:
        """The whole records from the beginning of the data on."""
        places: list[int] = []
        position, head, last = 0, _FRAME.size, len(data) - _FRAME.size
        found, length_at = places.append, _LENGTH.unpack_from
        # All that is done for each record by itself, since each says where the next one is.
        while position <= last:
            found(position)
            position += head + length_at(data, position)[0]
        whole = position <= len(data)
        places.append(position)
        bounds = np.array(places if whole else places[:-1], dtype=np.int64)
        letters = np.ndarray((len(data),), np.uint8, data)
        return cls(data, letters[bounds[:-1]], bounds[:-1] + _FRAME.size, bounds[1:], whole)

    def contents(self, rows: IntArray) -> Iterator[tuple[int, Content]]:
        """Opcode and content of some of the records."""
        view = memoryview(self.data)
        for row in rows.tolist():
            yield int(self.opcodes[row]), view[self.starts[row] : self.ends[row]]


def runs(file: BufferedReader, damage: Damage) -> Iterator[Run]:
    """All records of a file in runs; those of a chunk are a run in its place.

    Reading stops behind the footer. Attachments and indexes are passed over.
    """
    waiting = bytearray()
    for opcode, content in records(file, damage):
        if waiting and (opcode == CHUNK or len(waiting) + len(content) > _LARGEST_RUN):
            yield Run.of(bytes(waiting))
            waiting = bytearray()
        if opcode == CHUNK:
            yield from _of_chunk(content, file.tell(), damage)
        elif opcode == MESSAGE_INDEX:
            damage.messages += _indexed_messages(content) if damage.after_chunk else 0
        else:
            waiting += _FRAME.pack(opcode, len(content)) + content
    if waiting:
        yield Run.of(bytes(waiting))


def records(file: BufferedReader, damage: Damage) -> Iterator[tuple[int, Content]]:
    """Opcode and content of the records of a file, chunks as they are.

    Of a chunk that the file breaks off in, the records that can be unpacked are given instead.
    """
    size = file.seek(0, 2)
    file.seek(len(MAGIC))
    checksum = crc32(MAGIC)
    while True:
        position = file.tell()
        head = file.read(_FRAME.size)
        opcode, length = _FRAME.unpack(head) if len(head) == _FRAME.size else (0, 0)
        left = size - position - _FRAME.size
        if opcode == DATA_END and 4 <= length <= left and not damage.places:
            _check_data(file, checksum, damage)
            file.seek(position + _FRAME.size + length)
            continue
        if opcode == 0 or length > left:
            passed = 1
            if opcode == CHUNK:
                content = file.read(min(length, left, _LARGEST_CHUNK))
                yield from _start_of_chunk(content, damage)
                passed = _FRAME.size + _extent(content)
            if not _seek_next(file, position, passed, size, damage):
                return
            checksum = 0
        elif opcode in _KEPT:
            content = file.read(length)
            checksum = crc32(content, crc32(head, checksum))
            yield opcode, content
            if opcode == FOOTER:
                return
        else:
            checksum = _pass_over(file, length, crc32(head, checksum))


def _pass_over(file: BufferedReader, length: int, checksum: int) -> int:
    while length > 0:
        piece = file.read(min(length, _PIECE))
        if not piece:
            break
        checksum = crc32(piece, checksum)
        length -= len(piece)
    return checksum


def _check_data(file: BufferedReader, checksum: int, damage: Damage) -> None:
    (declared,) = struct.unpack("<I", file.read(4))
    if declared and checksum and declared != checksum:
        damage.add("the checksum of the data section differs: some of what was read may be wrong")


def _seek_next(file: BufferedReader, position: int, passed: int, size: int, damage: Damage) -> bool:
    """Go to the next record behind damage and what was read of it; False when there is none."""
    following = _next_record(file, position + passed, size)
    if following is None:
        damage.add(f"the file ends early, at byte {size}: what follows byte {position} is lost")
        return False
    damage.add(f"damaged from byte {position} to {following}")
    file.seek(following)
    return True


def _next_record(file: BufferedReader, start: int, size: int) -> int | None:
    candidates = 0
    while start < size:
        file.seek(start)
        block = file.read(_SEARCH_STEP)
        for match in _START_OF_RECORD.finditer(block):
            candidates += 1
            if candidates > _MOST_CANDIDATES:
                return None
            if _chained(file, start + match.start(), size):
                return start + match.start()
        start += max(len(block) - _FRAME.size, 1)
    return None


def _chained(file: BufferedReader, position: int, size: int) -> bool:
    """Whether several records, or all up to the end of the file, follow from a position."""
    for _ in range(_LINKS):
        file.seek(position)
        head = file.read(_FRAME.size)
        if len(head) < _FRAME.size:
            return False
        opcode, length = _FRAME.unpack(head)
        position += _FRAME.size + length
        if not HEADER <= opcode <= DATA_END or position > size or not length:
            return False
        if opcode == FOOTER and position == size - len(MAGIC):
            return True
    return True


def _of_chunk(content: Content, end: int, damage: Damage) -> Iterator[Run]:
    try:
        run = Run.of(_unpacked(content))
    except DamagedRecordError as error:
        damage.add(f"damaged chunk before byte {end} ({error})")
        damage.after_chunk = True
        return
    damage.after_chunk = False
    yield run
    if not run.whole:
        damage.add(f"damaged chunk before byte {end} (a record reaches beyond its end)")


def _unpacked(content: Content) -> Content:
    """Records of a chunk, checked."""
    size, checksum, compression, packed = _chunk_head(content)
    try:
        data = _decompress(compression, packed, size)
    except (RuntimeError, zstandard.ZstdError, ValueError, MemoryError, EOFError) as error:
        raise DamagedRecordError(f"{compression}: {' '.join(str(error).split())}") from error
    if len(data) != size:
        raise DamagedRecordError(f"holds {len(data)} bytes of {size}")
    if checksum and crc32(data) != checksum:
        raise DamagedRecordError("its checksum differs")
    return data


def _chunk_head(content: Content) -> tuple[int, int, str, Content]:
    """Size when unpacked, checksum, compression and the packed bytes."""
    try:
        _, _, size, checksum, letters = _CHUNK_HEAD.unpack_from(content)
        start = _CHUNK_HEAD.size + letters
        compression = bytes(content[_CHUNK_HEAD.size : start]).decode("ascii")
        (length,) = struct.unpack_from("<Q", content, start)
    except (struct.error, ValueError) as error:
        raise DamagedRecordError("its head cannot be read") from error
    if size > _LARGEST_CHUNK:
        raise DamagedRecordError(f"it claims {size} bytes")
    return size, checksum, compression, memoryview(content)[start + 8 : start + 8 + length]


def _decompress(compression: str, packed: Content, size: int) -> Content:
    if not compression or not size:
        return packed
    if compression == "zstd":
        declared = zstandard.frame_content_size(packed)
        if declared > size:
            raise ValueError(f"unpacks to {declared} bytes, not {size}")
        return _ZSTD.decompress(packed, max_output_size=size)
    if compression == "lz4":
        return unpack_lz4(packed, size)
    raise ValueError("this compression is unknown")


def _start_of_chunk(content: Content, damage: Damage) -> Iterator[tuple[int, Content]]:
    """Whole records of a chunk whose end is not there; its checksum cannot be checked."""
    try:
        size, _, compression, packed = _chunk_head(content)
        run = Run.of(_decompress_start(compression, packed, size))
        yield from run.contents(np.arange(len(run.opcodes)))
    except (DamagedRecordError, RuntimeError, zstandard.ZstdError, ValueError, EOFError):
        damage.after_chunk = False


def _decompress_start(compression: str, packed: Content, size: int) -> Content:
    if compression == "zstd":
        return zstandard.ZstdDecompressor().decompressobj().decompress(packed)[:size]
    return _decompress(compression, packed, size)


def _extent(content: bytes) -> int:
    """Bytes that a chunk without a sound record length takes, by what its head says."""
    try:
        _, _, compression, packed = _chunk_head(content)
    except DamagedRecordError:
        return 0
    return _CHUNK_HEAD.size + len(compression) + 8 + len(packed)


def _indexed_messages(content: Content) -> int:
    """How many messages a message index lists."""
    if len(content) < 6:
        return 0
    return int(struct.unpack_from("<I", content, 2)[0]) // 16
