"""MCAP files as containers of messages (https://mcap.dev/spec).

Records are read one after the other, not by the index, so that a file without a usable summary or
with damage gives what it holds. The summary helps where it is whole: it names the channels at once,
and those whose record was lost with a damaged chunk.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Final

import numpy as np

from hbbatch.sources.base import Findings, IntArray
from hbbatch.sources.blocks import Block, BlockBuilder, gather
from hbbatch.sources.channels import (
    LATEST_NS,
    Channel,
    Count,
    Wanted,
    file_hash,
    starts_with,
)
from hbbatch.sources.mcap_records import (
    CHANNEL,
    FOOTER,
    HEADER,
    MAGIC,
    MESSAGE,
    SCHEMA,
    STATISTICS,
    Content,
    Damage,
    DamagedRecordError,
    Run,
    records,
    runs,
)
from hbbatch.sources.messages import normalise_type

_FOOTER_SIZE: Final = 9 + 20
_LARGEST_SUMMARY: Final = 2**28
_MESSAGE_HEAD: Final = np.dtype(
    [
        ("channel_id", "<u2"),
        ("sequence", "<u4"),
        ("log_time_ns", "<u8"),
        ("publish_time_ns", "<u8"),
    ]
)
_UNWANTED, _UNKNOWN = -1, -2
_STATISTICS_HEAD: Final = struct.Struct("<QHI")


def is_mcap_file(path: Path) -> bool:
    """Whether a path is a file that starts as MCAP files do.

    Raises:
        OSError: the file cannot be read.
    """
    return starts_with(path, MAGIC)


@dataclass(frozen=True)
class McapLog:
    """An MCAP file."""

    path: Path
    format_name: str = "mcap"

    def profile(self) -> str:
        """The profile of its header."""
        with self.path.open("rb") as file:
            opcode, content = next(records(file, Damage()), (0, b""))
        try:
            return _Fields(content).text() if opcode == HEADER else ""
        except DamagedRecordError:
            return ""

    def channels(self, findings: Findings) -> Sequence[Channel]:
        """All channels: from the summary where it is whole, else by reading the file."""
        with self.path.open("rb") as file:
            summary = _summary(file)
        if summary.complete:
            return list(summary.by_id.values())
        met: dict[Channel, None] = {}

        def remember(channel: Channel) -> bool:
            met[channel] = None
            return False

        for _ in self.blocks(remember, findings):
            pass
        return list(met)

    def blocks(self, wanted: Wanted, findings: Findings) -> Iterator[Block]:
        """Messages of the wanted channels in file order, damaged places left out."""
        damage, count, builder = Damage(), Count(), BlockBuilder()
        with self.path.open("rb") as file:
            table = _summary(file)
            count.expected = table.declared
            table.announce(wanted)
            for run in runs(file, damage):
                heads = table.take(run, damage)
                count.read += heads.met
                if not len(heads.codes):
                    continue
                if not builder.fits(len(run.data)):
                    yield from builder.take(table.wanted)
                builder.add(run.data, heads.starts, heads.ends, heads.codes, heads.log_time_ns)
            yield from builder.take(table.wanted)
        if table.unknown:
            findings.lost(
                f"{table.unknown} messages lost: the record that names their topic is missing"
            )
        damage.report(findings)
        count.expected = table.declared
        count.report(findings)

    def fingerprint(self) -> str:
        """Hash of all bytes of the file."""
        return file_hash(self.path)


class _Fields:
    """Fields of a record, read one after the other."""

    def __init__(self, content: Content) -> None:
        self._content, self._position = content, 0

    def number(self, kind: str) -> int:
        try:
            (value,) = struct.unpack_from(f"<{kind}", self._content, self._position)
        except struct.error as error:
            raise DamagedRecordError("a record is too short") from error
        self._position += struct.calcsize(f"<{kind}")
        return int(value)

    def bytes(self) -> bytes:
        length = self.number("I")
        start = self._position
        self._position += length
        if self._position > len(self._content):
            raise DamagedRecordError("a record is too short")
        return bytes(self._content[start : self._position])

    def text(self) -> str:
        try:
            return self.bytes().decode()
        except UnicodeDecodeError as error:
            raise DamagedRecordError("a text is not UTF-8") from error


@dataclass(frozen=True)
class _Heads:
    """The m messages of wanted channels in a run.

    Attributes:
        met: messages of all channels in the run.
        starts: `(m,)` where the bytes of each begin in the data of the run.
        ends: `(m,)` where they end.
        codes: `(m,)` index into the wanted channels of the table.
        log_time_ns: `(m,)`.
    """

    met: int
    starts: IntArray
    ends: IntArray
    codes: IntArray
    log_time_ns: IntArray


class _Table:
    """Channels met so far; a channel without a schema has an empty type.

    Attributes:
        by_id: all of them.
        wanted: those that are wanted; it only grows, so that their numbers hold.
        declared: messages that the file says it holds, None when it does not say.
        unknown: messages met of channels that are not known.
        complete: whether the summary named all channels.
    """

    def __init__(self) -> None:
        self.by_id: dict[int, Channel] = {}
        self.wanted: list[Channel] = []
        self.declared: int | None = None
        self.unknown = 0
        self.complete = False
        self._codes = np.full(2**16, _UNKNOWN, dtype=np.int64)
        self._declared_channels = -1
        self._schemas: dict[int, tuple[str, str, bytes]] = {}
        self._unresolved: set[int] = set()
        self._wants: Wanted = lambda _: False

    def announce(self, wanted: Wanted) -> None:
        """Say which channels are wanted, of those known and those to come."""
        self._wants = wanted
        for channel_id, channel in self.by_id.items():
            if channel_id not in self._unresolved:
                self._offer(channel_id, channel)

    def take(self, run: Run, damage: Damage) -> _Heads:
        """Learn from the records that are no messages, and find the wanted of those that are."""
        is_message = run.opcodes == MESSAGE
        for opcode, content in run.contents(np.flatnonzero(~is_message)):
            self._learn(opcode, content, damage)
        starts, ends = run.starts[is_message], run.ends[is_message]
        met = len(starts)
        long_enough = ends - starts >= _MESSAGE_HEAD.itemsize
        if not long_enough.all():
            for _ in range(int((~long_enough).sum())):
                damage.add("a message without head")
            starts, ends = starts[long_enough], ends[long_enough]
        heads = gather(run.data, starts, _MESSAGE_HEAD)
        codes = self._codes[heads["channel_id"]]
        self.unknown += int((codes == _UNKNOWN).sum())
        rows = np.flatnonzero(codes >= 0)
        log_time_ns = np.minimum(heads["log_time_ns"][rows], LATEST_NS).astype(np.int64)
        first = starts[rows] + _MESSAGE_HEAD.itemsize
        return _Heads(met, first, ends[rows], codes[rows], log_time_ns)

    def _learn(self, opcode: int, content: Content, damage: Damage) -> None:
        try:
            if opcode == SCHEMA:
                self._take_schema(_Fields(content))
            elif opcode == CHANNEL:
                self._take_channel(_Fields(content))
            elif opcode == STATISTICS:
                self.declared, _, self._declared_channels = _STATISTICS_HEAD.unpack_from(content)
        except (DamagedRecordError, struct.error) as error:
            damage.add(f"a damaged record ({error})")

    def close(self) -> None:
        """Decide whether all channels are known with their schemas."""
        self.complete = not self._unresolved and self._declared_channels == len(self.by_id) > 0

    def _take_schema(self, fields: _Fields) -> None:
        schema_id = fields.number("H")
        self._schemas[schema_id] = (fields.text(), fields.text(), fields.bytes())

    def _take_channel(self, fields: _Fields) -> None:
        channel_id, schema_id = fields.number("H"), fields.number("H")
        topic, encoding = fields.text(), fields.text()
        if channel_id in self.by_id and channel_id not in self._unresolved:
            return
        name, schema_encoding, definition = self._schemas.get(schema_id, ("", "", b""))
        self._unresolved.discard(channel_id)
        if schema_id and schema_id not in self._schemas:
            self._unresolved.add(channel_id)
        channel = Channel(topic, normalise_type(name), encoding, schema_encoding, definition)
        self.by_id[channel_id] = channel
        self._offer(channel_id, channel)

    def _offer(self, channel_id: int, channel: Channel) -> None:
        self._codes[channel_id] = _UNWANTED
        if self._wants(channel):
            self._codes[channel_id] = len(self.wanted)
            self.wanted.append(channel)


def _summary(file: BufferedReader) -> _Table:
    """Channels and declared count of the summary; an empty table when there is none."""
    table = _Table()
    run = _summary_run(file)
    if run is not None and run.whole:
        table.take(run, Damage())
        table.close()
    return table


def _summary_run(file: BufferedReader) -> Run | None:
    end = file.seek(0, 2) - len(MAGIC) - _FOOTER_SIZE
    if end < len(MAGIC):
        return None
    file.seek(end)
    tail = file.read(_FOOTER_SIZE + len(MAGIC))
    (start,) = struct.unpack_from("<Q", tail, 9)
    whole = tail[0] == FOOTER and tail.endswith(MAGIC)
    if not whole or not len(MAGIC) <= start < end or end - start > _LARGEST_SUMMARY:
        return None
    file.seek(start)
    return Run.of(file.read(end - start))
