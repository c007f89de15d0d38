"""Messages of a channel read in batches: together by a direct walk, or one by one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np
from rosbags.typesys.store import Typestore

from hbbatch.errors import SourceError
from hbbatch.sources.base import IntArray, SourceOptions
from hbbatch.sources.blocks import Payloads
from hbbatch.sources.cdr_columns import DETECTION_WALKS, TRANSFORM_WALKS
from hbbatch.sources.cdr_steps import WalkRefusedError
from hbbatch.sources.channels import Channel
from hbbatch.sources.columns import (
    DetectionColumns,
    TransformColumns,
    from_messages,
    from_samples,
)
from hbbatch.sources.decoding import UNDECODABLE, Decoder, decoder, layout
from hbbatch.sources.messages import DETECTION_MESSAGES

_One = TypeVar("_One")
_Many = TypeVar("_Many")


@dataclass
class ChannelReader(Generic[_One, _Many]):
    """Reads the messages of a channel.

    Attributes:
        channel: the channel.
        options: what the user said about the source.
        read_one: what one decoded message says.
        join: many of those as a batch.
        walks: by type, what makes the direct walk for a definition.
        problem: why messages that were met cannot be decoded.
        note: what a user should know of how they are decoded.
        undecodable: messages that did not fit their definition, or their mapping file.
        reason: what was wrong with the first of them.
    """

    channel: Channel
    options: SourceOptions
    read_one: Callable[[Any], _One]
    join: Callable[[Sequence[_One]], _Many]
    walks: Mapping[str, Callable[[Typestore, str], Callable[[Payloads], _Many]]]
    problem: str = ""
    note: str = ""
    undecodable: int = 0
    reason: str = ""

    def read(self, messages: Payloads) -> tuple[_Many, IntArray] | None:
        """What messages say, and which of them could be read; None when none could."""
        if self._walk is not None:
            try:
                return self._walk(messages), np.arange(len(messages))
            except WalkRefusedError:
                pass
        return None if self._decoder is None else self._one_by_one(messages, self._decoder.decode)

    def _one_by_one(
        self, messages: Payloads, decode: Callable[[bytes], Any]
    ) -> tuple[_Many, IntArray] | None:
        said, kept = [], []
        for row, data in enumerate(messages):
            try:
                said.append(self.read_one(decode(data)))
                kept.append(row)
            except UNDECODABLE as error:
                self.undecodable += 1
                self.reason = self.reason or str(error) or type(error).__name__
        return (self.join(said), np.array(kept, dtype=np.int64)) if said else None

    @cached_property
    def _walk(self) -> Callable[[Payloads], _Many] | None:
        """A batch from the bytes of all messages, None where there is no direct walk."""
        kind = self.channel.message_type
        if kind not in self.walks:
            return None
        store = layout(self.channel) or (self._decoder and self._decoder.typestore)
        try:
            return self.walks[kind](store, kind) if store else None
        except (WalkRefusedError, KeyError, RecursionError):
            return None

    @cached_property
    def _decoder(self) -> Decoder | None:
        """For what is not walked; making it takes longer than making a walk."""
        try:
            made = decoder(self.channel, self.options)
        except SourceError as error:
            self.problem = str(error)
            return None
        self.note = made.note
        return made


def detection_reader(
    channel: Channel, read: Callable[[Any], Any], options: SourceOptions
) -> ChannelReader[Any, DetectionColumns]:
    """The reader of a channel of detections."""
    # What a mapping file says of a type counts, also of one that there is a walk for.
    is_mapped = read is not DETECTION_MESSAGES.get(channel.message_type)
    walks = {} if is_mapped else DETECTION_WALKS
    return ChannelReader(channel, options, read, from_messages, walks)


def transform_reader(
    channel: Channel, read: Callable[[Any], Any], options: SourceOptions
) -> ChannelReader[Any, TransformColumns]:
    """The reader of a channel of transforms or poses."""

    def samples(message: Any) -> list[Any]:
        return list(read(message))

    return ChannelReader(channel, options, samples, from_samples, TRANSFORM_WALKS)


def satellite_reader(
    channel: Channel, read: Callable[[Any], Any], options: SourceOptions
) -> ChannelReader[Any, list[Any]]:
    """The reader of a channel of satellite fixes or orientations."""
    return ChannelReader(channel, options, read, list, {})
