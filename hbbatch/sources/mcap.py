"""MCAP files as containers of messages (https://mcap.dev/spec).

Records are read one after the other, not by the index, so that a file without a usable summary or
with a damaged end gives what it holds.
"""

from __future__ import annotations

import hashlib
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Final

import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import make_reader
from mcap.records import Channel as ChannelRecord
from mcap.records import McapRecord, Message, Schema, Statistics
from mcap.stream_reader import StreamReader

from hbbatch.sources.base import Findings
from hbbatch.sources.channels import Channel, RawMessage
from hbbatch.sources.messages import normalise_type

_MAGIC: Final = b"\x89MCAP0\r\n"
_LARGEST_RECORD: Final = 2**30
_LATEST_NS: Final = 2**63 - 1
_DAMAGE: Final = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    KeyError,
    RuntimeError,
    MemoryError,
)
"""What mcap and its decompressors raise on bytes that are not as the specification says."""


def is_mcap_file(path: Path) -> bool:
    """Whether a path is a file that starts as MCAP files do.

    Raises:
        OSError: the file cannot be read.
    """
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC


@dataclass(frozen=True)
class McapLog:
    """An MCAP file."""

    path: Path
    format_name: str = "mcap"

    def channels(self, findings: Findings) -> Sequence[Channel]:
        """All channels: from the summary where it is whole, else by reading the file."""
        with self.path.open("rb") as file:
            summarised = _summary_channels(file)
        if summarised:
            return summarised
        with self.path.open("rb") as file:
            channels = _Channels()
            for record in _records(file, findings):
                channels.take(record)
            return list(channels.by_id.values())

    def messages(
        self, wanted: Callable[[Channel], bool], findings: Findings
    ) -> Iterator[RawMessage]:
        """Messages of the wanted channels in file order, up to the first damage."""
        channels = _Channels()
        counts: Counter[int] = Counter()
        with self.path.open("rb") as file:
            for record in _records(file, findings):
                if isinstance(record, Message):
                    counts[record.channel_id] += 1
                    channel = channels.by_id.get(record.channel_id)
                    if channel is not None and wanted(channel):
                        # MCAP's times are unsigned; a damaged one must still fit the tables.
                        log_time_ns = min(record.log_time, _LATEST_NS)
                        yield RawMessage(channel, log_time_ns, record.data)
                elif isinstance(record, Statistics):
                    _compare(record, counts, findings)
                else:
                    channels.take(record)

    def fingerprint(self) -> str:
        """Hash of all bytes of the file."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "blake2b").hexdigest()


class _Channels:
    """Channels met so far; a channel without a schema has an empty type."""

    def __init__(self) -> None:
        self.by_id: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}

    def take(self, record: McapRecord) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, ChannelRecord) and record.id not in self.by_id:
            self.by_id[record.id] = _channel(record, self._schemas.get(record.schema_id))


def _channel(record: ChannelRecord, schema: Schema | None) -> Channel:
    return Channel(
        topic=record.topic,
        message_type=normalise_type(schema.name) if schema else "",
        message_encoding=record.message_encoding,
        schema_encoding=schema.encoding if schema else "",
        definition=schema.data if schema else b"",
    )


def _records(file: BufferedReader, findings: Findings) -> Iterator[McapRecord]:
    """Records of a file until its end or the first damage."""
    reader = StreamReader(file, validate_crcs=True, record_size_limit=_LARGEST_RECORD)
    try:
        yield from reader.records
    except EndOfFile:
        findings.lost(f"the file ends early, at byte {file.tell()}: what follows is lost")
    except _DAMAGE as error:
        what = " ".join(str(error).split()) or type(error).__name__
        findings.lost(f"damaged before byte {file.tell()} ({what}): what follows is lost")


def _summary_channels(file: BufferedReader) -> list[Channel]:
    """Channels of the summary; empty when there is none or it lacks some of the schemas."""
    try:
        summary = make_reader(file).get_summary()
    except (*_DAMAGE, OSError):
        return []
    if summary is None or any(
        channel.schema_id and channel.schema_id not in summary.schemas
        for channel in summary.channels.values()
    ):
        return []
    return [
        _channel(channel, summary.schemas.get(channel.schema_id))
        for channel in summary.channels.values()
    ]


def _compare(declared: Statistics, counts: Counter[int], findings: Findings) -> None:
    if declared.message_count > counts.total():
        findings.lost(
            f"the file declares {declared.message_count} messages and holds {counts.total()}"
        )
