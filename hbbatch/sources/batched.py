"""Messages of a channel read in batches: together by a direct walk, or one by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Generic, TypeVar

from hbbatch.errors import SourceError
from hbbatch.sources.base import SourceOptions
from hbbatch.sources.cdr_columns import DETECTION_WALKS, TRANSFORM_WALKS
from hbbatch.sources.cdr_walk import WalkRefusedError
from hbbatch.sources.channels import Channel, RawMessage
from hbbatch.sources.columns import (
    DetectionColumns,
    TransformColumns,
    from_messages,
    from_samples,
)
from hbbatch.sources.decoding import UNDECODABLE, Decoder, decoder

_BATCH_MESSAGES: Final = 1024
_BATCH_BYTES: Final = 16 * 2**20
_One = TypeVar("_One")
_Many = TypeVar("_Many")


@dataclass
class ChannelReader(Generic[_One, _Many]):
    """Collects messages of a channel and reads them when there are enough.

    Attributes:
        channel: the channel.
        read: what one decoded message says.
        join: many of those as a batch.
        walk: a batch from the bytes of all messages, None where there is no direct walk.
        decode: bytes to a decoded message, None when the channel cannot be decoded.
        problem: why it cannot be decoded.
        note: what a user should know of how it is decoded.
        undecodable: messages that did not fit their definition.
    """

    channel: Channel
    read: Callable[[Any], _One]
    join: Callable[[Sequence[_One]], _Many]
    walk: Callable[[Sequence[bytes]], _Many] | None
    decode: Callable[[bytes], Any] | None
    problem: str = ""
    note: str = ""
    undecodable: int = 0
    _waiting: list[tuple[int, RawMessage]] = field(default_factory=list)
    _waiting_bytes: int = 0

    def add(self, number: int, message: RawMessage) -> bool:
        """Take a message; True when it is time to `flush`."""
        self._waiting.append((number, message))
        self._waiting_bytes += len(message.data)
        return len(self._waiting) >= _BATCH_MESSAGES or self._waiting_bytes >= _BATCH_BYTES

    def flush(self) -> tuple[_Many, list[tuple[int, RawMessage]]] | None:
        """What the messages taken say, and those of them that could be read."""
        waiting, self._waiting, self._waiting_bytes = self._waiting, [], 0
        if not waiting:
            return None
        if self.walk is not None:
            try:
                return self.walk([message.data for _, message in waiting]), waiting
            except WalkRefusedError:
                pass
        return self._one_by_one(waiting)

    def _one_by_one(
        self, waiting: list[tuple[int, RawMessage]]
    ) -> tuple[_Many, list[tuple[int, RawMessage]]] | None:
        said, kept = [], []
        for entry in waiting:
            try:
                if self.decode is None:
                    continue
                said.append(self.read(self.decode(entry[1].data)))
                kept.append(entry)
            except UNDECODABLE:
                self.undecodable += 1
        return (self.join(said), kept) if said else None


def detection_reader(
    channel: Channel, read: Callable[[Any], Any], options: SourceOptions
) -> ChannelReader[Any, DetectionColumns]:
    """The reader of a channel of detections."""
    decoding, problem = _decoding(channel, options)
    return ChannelReader(
        channel,
        read,
        from_messages,
        _walk(DETECTION_WALKS, channel, decoding),
        decoding.decode if decoding else None,
        problem,
        decoding.note if decoding else "",
    )


def transform_reader(
    channel: Channel, read: Callable[[Any], Any], options: SourceOptions
) -> ChannelReader[Any, TransformColumns]:
    """The reader of a channel of transforms or poses."""
    decoding, problem = _decoding(channel, options)
    return ChannelReader(
        channel,
        lambda message: list(read(message)),
        from_samples,
        _walk(TRANSFORM_WALKS, channel, decoding),
        decoding.decode if decoding else None,
        problem,
        decoding.note if decoding else "",
    )


def satellite_reader(
    channel: Channel, read: Callable[[Any], Any], options: SourceOptions
) -> ChannelReader[Any, list[Any]]:
    """The reader of a channel of satellite fixes or orientations."""
    decoding, problem = _decoding(channel, options)
    decode = decoding.decode if decoding else None
    note = decoding.note if decoding else ""
    return ChannelReader(channel, read, list, None, decode, problem, note)


def _decoding(channel: Channel, options: SourceOptions) -> tuple[Decoder | None, str]:
    try:
        return decoder(channel, options), ""
    except SourceError as error:
        return None, str(error)


def _walk(walks: Any, channel: Channel, decoding: Decoder | None) -> Any:
    if decoding is None or decoding.typestore is None or channel.message_type not in walks:
        return None
    try:
        return walks[channel.message_type](decoding.typestore, channel.message_type)
    except (WalkRefusedError, KeyError, RecursionError):
        return None
