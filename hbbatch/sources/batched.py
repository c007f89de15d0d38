"""Messages of a channel read in batches: together by a direct walk, or one by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from hbbatch.errors import SourceError
from hbbatch.sources.base import IntArray, SourceOptions
from hbbatch.sources.blocks import Payloads
from hbbatch.sources.cdr_columns import DETECTION_WALKS, TRANSFORM_WALKS
from hbbatch.sources.cdr_walk import WalkRefusedError
from hbbatch.sources.channels import Channel
from hbbatch.sources.columns import (
    DetectionColumns,
    TransformColumns,
    from_messages,
    from_samples,
)
from hbbatch.sources.decoding import UNDECODABLE, Decoder, decoder

_One = TypeVar("_One")
_Many = TypeVar("_Many")


@dataclass
class ChannelReader(Generic[_One, _Many]):
    """Reads the messages of a channel.

    Attributes:
        channel: the channel.
        read_one: what one decoded message says.
        join: many of those as a batch.
        walk: a batch from the bytes of all messages, None where there is no direct walk.
        decode: bytes to a decoded message, None when the channel cannot be decoded.
        problem: why it cannot be decoded.
        note: what a user should know of how it is decoded.
        undecodable: messages that did not fit their definition.
    """

    channel: Channel
    read_one: Callable[[Any], _One]
    join: Callable[[Sequence[_One]], _Many]
    walk: Callable[[Payloads], _Many] | None
    decode: Callable[[bytes], Any] | None
    problem: str = ""
    note: str = ""
    undecodable: int = 0

    def read(self, messages: Payloads) -> tuple[_Many, IntArray] | None:
        """What messages say, and which of them could be read; None when none could."""
        if self.walk is not None:
            try:
                return self.walk(messages), np.arange(len(messages))
            except WalkRefusedError:
                pass
        return None if self.decode is None else self._one_by_one(messages, self.decode)

    def _one_by_one(
        self, messages: Payloads, decode: Callable[[bytes], Any]
    ) -> tuple[_Many, IntArray] | None:
        said, kept = [], []
        for row, data in enumerate(messages):
            try:
                said.append(self.read_one(decode(data)))
                kept.append(row)
            except UNDECODABLE:
                self.undecodable += 1
        return (self.join(said), np.array(kept, dtype=np.int64)) if said else None


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
