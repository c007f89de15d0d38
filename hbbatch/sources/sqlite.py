"""ROS 2 .db3 files (rosbag2's SQLite storage) as containers of messages."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from hbbatch.sources.base import Findings
from hbbatch.sources.blocks import Block, in_blocks
from hbbatch.sources.channels import (
    LATEST_NS,
    Channel,
    Count,
    RawMessage,
    Wanted,
    file_hash,
    starts_with,
)
from hbbatch.sources.messages import normalise_type

_MAGIC: Final = b"SQLite format 3\x00"
_WINDOW: Final = 256
_MOST_FAILURES: Final = 2_000

_DAMAGE: Final = (sqlite3.Error, OverflowError, UnicodeDecodeError)
"""What a damaged file can raise; sqlite's own messages may quote bytes that are no text."""


def is_db3_file(path: Path) -> bool:
    """Whether a path is an SQLite file.

    Raises:
        OSError: the file cannot be read.
    """
    return starts_with(path, _MAGIC)


@dataclass(frozen=True)
class Db3Log:
    """A .db3 file; definitions are embedded from ROS 2 Iron on."""

    path: Path
    format_name: str = "rosbag2_sqlite3"

    def profile(self) -> str:
        """The files know of one system only."""
        return "ros2"

    def channels(self, findings: Findings) -> Sequence[Channel]:
        """All topics."""
        with closing(self._open()) as database:
            return list(_channels(database, findings).values())

    def blocks(self, wanted: Wanted, findings: Findings) -> Iterator[Block]:
        """Messages of the wanted channels, in blocks."""
        return in_blocks(self._messages(wanted, findings))

    def _messages(self, wanted: Wanted, findings: Findings) -> Iterator[RawMessage]:
        """Messages of the wanted topics in the order they were written."""
        with closing(self._open()) as database:
            channels = _channels(database, findings)
            chosen = {number: c for number, c in channels.items() if wanted(c)}
            count = Count(expected=_row_count(database))
            for topic, time_ns, data in _rows(database, chosen, count, findings):
                if isinstance(data, bytes) and isinstance(time_ns, int):
                    yield RawMessage(chosen[topic], min(max(time_ns, 0), LATEST_NS), data)
        count.report(findings)

    def fingerprint(self) -> str:
        """Hash of all bytes of the file."""
        return file_hash(self.path)

    def _open(self) -> sqlite3.Connection:
        # Immutable: no lock and no journal is made beside a file that may lie on a read-only disk.
        uri = f"{self.path.resolve().as_uri()}?mode=ro&immutable=1"
        database = sqlite3.connect(uri, uri=True)
        database.text_factory = _lenient_text
        return database


def _lenient_text(text: bytes) -> str:
    return text.decode(errors="replace")


def _channels(database: sqlite3.Connection, findings: Findings) -> dict[int, Channel]:
    try:
        topics = database.execute("SELECT id, name, type, serialization_format FROM topics")
        rows = topics.fetchall()
    except _DAMAGE as error:
        findings.lost(f"the table of topics cannot be read ({error})")
        return {}
    definitions = _definitions(database)
    return {
        number: _channel(str(topic), str(kind), str(encoding), definitions)
        for number, topic, kind, encoding in rows
    }


def _channel(
    topic: str, kind: str, encoding: str, definitions: dict[str, tuple[str, bytes]]
) -> Channel:
    schema_encoding, definition = definitions.get(kind, ("", b""))
    return Channel(topic, normalise_type(kind), encoding, schema_encoding, definition)


def _definitions(database: sqlite3.Connection) -> dict[str, tuple[str, bytes]]:
    try:
        rows = database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        ).fetchall()
    except _DAMAGE:
        # Before ROS 2 Iron there is no such table.
        return {}
    return {str(kind): (str(encoding), str(text).encode()) for kind, encoding, text in rows if text}


def _row_count(database: sqlite3.Connection) -> int | None:
    try:
        (count,) = database.execute("SELECT count(*) FROM messages").fetchone()
    except _DAMAGE:
        return None
    return int(count)


def _rows(
    database: sqlite3.Connection, chosen: dict[int, Channel], count: Count, findings: Findings
) -> Iterator[tuple[int, Any, Any]]:
    """Rows of the chosen topics; where the file is damaged it is tried a little further on."""
    marks = ",".join(str(int(number)) for number in chosen)
    query = (
        f"SELECT topic_id, timestamp, CASE WHEN topic_id IN ({marks}) THEN data END "  # noqa: S608
        "FROM messages WHERE id >= ? AND id < ? ORDER BY id"
    )
    first, failures, reason = 0, 0, ""
    last = _last_row(database)
    while first <= last and failures < _MOST_FAILURES:
        following = first + (1 if failures else _WINDOW)
        try:
            rows = database.execute(query, (first, following)).fetchall()
        except _DAMAGE as error:
            reason = reason or str(error)
            failures += 1
            first = first if following > first + 1 else following
            continue
        count.read += len(rows)
        yield from (row for row in rows if row[0] in chosen)
        first = following if rows or failures else _next_row(database, following, last)
    if failures:
        findings.lost(f"the table of messages is damaged ({reason}); read around it")


def _last_row(database: sqlite3.Connection) -> int:
    try:
        (last,) = database.execute("SELECT max(id) FROM messages").fetchone()
    except _DAMAGE:
        return _WINDOW * _MOST_FAILURES
    return last if isinstance(last, int) else -1


def _next_row(database: sqlite3.Connection, start: int, last: int) -> int:
    """The first row number that is not below `start`; numbers may have wide gaps."""
    try:
        (row,) = database.execute("SELECT min(id) FROM messages WHERE id >= ?", (start,)).fetchone()
    except _DAMAGE:
        return start
    return row if isinstance(row, int) else last + 1
