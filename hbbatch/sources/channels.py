"""What every container of recorded messages gives, whatever its file format."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
from xxhash import xxh3_128

from hbbatch.sources.base import Findings

_LZ4_MOST: Final = 255
_LZ4_SPARE: Final = 2**16
LATEST_NS: Final = 2**63 - 1
"""Log times are unsigned in some containers; a damaged one must still fit the tables."""


@dataclass(frozen=True)
class Channel:
    """A topic as one writer published it.

    Attributes:
        topic: name of the topic.
        message_type: as `package/msg/Type`.
        message_encoding: of the messages, such as cdr.
        schema_encoding: of the definition, such as ros2msg; empty when there is none.
        definition: text or bytes of the definition, empty when there is none.
    """

    topic: str
    message_type: str
    message_encoding: str
    schema_encoding: str
    definition: bytes


class RawMessage(NamedTuple):
    """A message as recorded."""

    channel: Channel
    log_time_ns: int
    data: bytes


Wanted = Callable[[Channel], bool]


@dataclass
class Count:
    """Messages that a container holds, against those it says it holds.

    Attributes:
        read: messages met, wanted or not.
        expected: messages declared, None when the container does not say.
    """

    read: int = 0
    expected: int | None = None

    def report(self, findings: Findings, where: str = "the file") -> None:
        """Write down what is missing, or what is there although it is not declared."""
        findings.messages_read = max(findings.messages_read, self.read)
        if self.expected is not None:
            expected = max(findings.messages_expected or 0, self.expected)
            findings.messages_expected = expected
        if self.expected is None and findings.partial:
            findings.note(f"{self.read} messages were read; how many there were is not known")
        if self.expected is None or self.expected == self.read:
            return
        if self.expected > self.read:
            findings.lost(
                f"{where} declares {self.expected} messages, {self.read} were read: "
                f"{self.expected - self.read} lost"
            )
        else:
            findings.note(
                f"{where} declares {self.expected} messages, {self.read} were read: "
                "the declaration is wrong"
            )


def starts_with(path: Path, magic: bytes) -> bool:
    """Whether a path is a file whose first bytes are these.

    Raises:
        OSError: the file cannot be read.
    """
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(magic)) == magic


def unpack_lz4(data: bytes | memoryview, size: int) -> bytes:
    """Unpack at most `size` bytes of an LZ4 frame; of one without end, its start.

    A frame cannot hold more than 255 times its own length, so a size that a damaged file claims is
    never asked for as memory.

    Raises:
        RuntimeError: it is no LZ4 frame.
    """
    most = min(size, _LZ4_MOST * len(data) + _LZ4_SPARE)
    unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most)
    return unpacked


def file_hash(path: Path) -> str:
    """Hash of all bytes of a file: it tells a changed file, not one that was forged.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb", buffering=0) as file:
        return hashlib.file_digest(file, xxh3_128).hexdigest()
