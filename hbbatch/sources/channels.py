"""What every container of recorded messages gives, whatever its file format."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from hbbatch.sources.base import Findings


@dataclass(frozen=True)
class Channel:
    """A topic as one writer published it.

    Attributes:
        topic: name of the topic.
        message_type: as `package/msg/Type`.
        message_encoding: of the messages, such as cdr.
        schema_encoding: of the definition, such as ros2msg.
        definition: text or bytes of the definition.
    """

    topic: str
    message_type: str
    message_encoding: str
    schema_encoding: str
    definition: bytes


@dataclass(frozen=True)
class RawMessage:
    """A message as recorded."""

    channel: Channel
    log_time_ns: int
    data: bytes


class MessageLog(Protocol):
    """A container of messages."""

    @property
    def path(self) -> Path:
        """The file."""
        ...

    @property
    def format_name(self) -> str:
        """Name of the format, for the catalogue."""
        ...

    def channels(self, findings: Findings) -> Sequence[Channel]:
        """All channels, those without messages included; damage goes to the findings.

        Raises:
            OSError: the file cannot be read.
        """
        ...

    def messages(
        self, wanted: Callable[[Channel], bool], findings: Findings
    ) -> Iterator[RawMessage]:
        """Messages of the wanted channels as they lie in the file; damage goes to the findings.

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
