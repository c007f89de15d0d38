"""Bytes of a message to an object with its fields, by encoding and embedded definition.

An encoding is added as an entry of `_DECODERS`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from hbbatch.errors import SourceError
from hbbatch.sources.channels import Channel

Decode = Callable[[bytes], Any]

UNDECODABLE: Final = (
    SerdeError,
    struct.error,
    ValueError,
    IndexError,
    AssertionError,
    AttributeError,
)
"""What is raised for bytes that do not fit their definition, or fields that are not there."""


def decoder(channel: Channel) -> Decode:
    """A function from the bytes of a channel's messages to objects with the fields as attributes.

    Raises:
        SourceError: the encoding is unknown or the embedded definition cannot be used.
    """
    encodings = (channel.message_encoding, channel.schema_encoding)
    make = _DECODERS.get(encodings)
    if make is None:
        known = ", ".join(f"{message} with {schema}" for message, schema in _DECODERS)
        raise SourceError(
            f"topic {channel.topic}: messages are {encodings[0] or 'unnamed'} with "
            f"{encodings[1] or 'no'} definition. Can be read: {known}."
        )
    return make(channel)


def _ros2(channel: Channel) -> Decode:
    """A typestore of its own for each channel, so that one definition cannot spoil another's."""
    try:
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(channel.definition.decode(), channel.message_type))
        store.get_msgdef(channel.message_type)
    except (TypesysError, UnicodeDecodeError, KeyError) as error:
        raise SourceError(
            f"topic {channel.topic}: the embedded definition of {channel.message_type} cannot be "
            f"used ({' '.join(str(error).split())}). Record the log again with full definitions."
        ) from error
    return lambda data: store.deserialize_cdr(data, channel.message_type)


_DECODERS: Final[dict[tuple[str, str], Callable[[Channel], Decode]]] = {("cdr", "ros2msg"): _ros2}
