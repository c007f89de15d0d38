"""Bytes of a message to an object with its fields, by encoding and definition.

An encoding is added as an entry of `_DECODERS`. Definitions come embedded in the log, or for logs
that embed none from folders of .msg files, from a release of ROS 2, and from those hbbatch knows.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from hbbatch.errors import SourceError, UsageError
from hbbatch.sources.base import SourceOptions
from hbbatch.sources.channels import Channel
from hbbatch.sources.messages.definitions import KNOWN_DEFINITIONS

Decode = Callable[[bytes], Any]

UNDECODABLE: Final = (
    SerdeError,
    TypesysError,
    SyntaxError,
    NameError,
    struct.error,
    ValueError,
    IndexError,
    KeyError,
    AssertionError,
    AttributeError,
    TypeError,
    OverflowError,
    MemoryError,
    RecursionError,
)
"""What is raised for bytes that do not fit their definition, or fields that are not there."""

_ROS_TIME: Final = "int32 sec\nuint32 nanosec\n"
_DEFAULT_DISTRO: Final = "humble"
_MOST_ELEMENTS: Final = 10_000
_DISTROS: Final = {
    store.value.removeprefix("ros2_"): store for store in Stores if store.value.startswith("ros2_")
}


@dataclass(frozen=True)
class Decoder:
    """How to read the messages of a channel.

    Attributes:
        decode: bytes to an object with the fields as attributes.
        typestore: holds the definition, None where it is no ROS 2 definition, or is not certain.
        note: what a user should know of it, empty when nothing.
    """

    decode: Decode
    typestore: Typestore | None = None
    note: str = ""


def decoder(channel: Channel, options: SourceOptions) -> Decoder:
    """How to read the messages of a channel.

    Raises:
        SourceError: the encoding is unknown or no usable definition is there.
        UsageError: an option names a release or folder that is not there.
    """
    encodings = (channel.message_encoding, channel.schema_encoding)
    make = _DECODERS.get(encodings)
    if make is None:
        known = ", ".join(f"{message} with {schema or 'no'}" for message, schema in _DECODERS)
        raise SourceError(
            f"topic {channel.topic}: messages are {encodings[0] or 'unnamed'} with "
            f"{encodings[1] or 'no'} definition. Can be read: {known}."
        )
    try:
        return make(channel, options)
    except UNDECODABLE as error:
        raise SourceError(
            f"topic {channel.topic}: the embedded definition of {channel.message_type} cannot be "
            f"used ({' '.join(str(error).split())}). Record the log again with full definitions."
        ) from error


def layout(channel: Channel) -> Typestore | None:
    """The embedded definition of CDR messages, to look up fields but not to decode with.

    None where there is none that can be used; `decoder` says why. It takes a third of the time that
    a decoder takes, for which classes are generated.
    """
    parse = _CDR_PARSERS.get(channel.schema_encoding)
    if channel.message_encoding != "cdr" or parse is None:
        return None
    store = get_typestore(Stores.EMPTY)
    try:
        types = _embedded_types(parse, channel.definition, channel.message_type)
        store.fielddefs.update({name: definition[:2] for name, definition in types.items()})
        _check_whole(store, channel.message_type)
    except UNDECODABLE:
        return None
    return store


@lru_cache(maxsize=64)
def _embedded(parse: Callable[[str, str], Any], definition: bytes, kind: str) -> Typestore:
    """A typestore of its own for each definition, so that one cannot spoil another's."""
    store = get_typestore(Stores.EMPTY)
    store.register(_embedded_types(parse, definition, kind))
    _check_whole(store, kind)
    return store


def _embedded_types(
    parse: Callable[[str, str], Any], definition: bytes, kind: str
) -> dict[str, Any]:
    types: dict[str, Any] = parse(definition.decode(), kind)
    for name in ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"):
        if name not in types:
            types.update(get_types_from_msg(_ROS_TIME, name))
    return types


def _check_whole(store: Typestore, kind: str) -> None:
    """Raise a KeyError unless a type and all that it holds are defined.

    Code is generated for each element of a fixed array of anything but numbers: a ValueError is
    raised for more of these than a definition has that means it.
    """
    waiting, met, elements = [kind], {kind}, 0
    while waiting:
        for _, field in store.fielddefs[waiting.pop()][1]:
            node: Any = field[0]
            argument: Any = field[1]
            while node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                (inner, about), count = argument
                if node == Nodetype.ARRAY and (inner != Nodetype.BASE or about[0] == "string"):
                    elements += count
                node, argument = inner, about
            if node == Nodetype.NAME and argument not in met:
                met.add(argument)
                waiting.append(argument)
    if elements > _MOST_ELEMENTS:
        raise ValueError(f"its fixed arrays have {elements} elements")


def _ros2(channel: Channel, _: SourceOptions) -> Decoder:
    parse = _CDR_PARSERS[channel.schema_encoding]
    store = _embedded(parse, channel.definition, channel.message_type)
    return Decoder(partial(_cdr, store, channel.message_type), store)


def _types_from_idl(text: str, _kind: str) -> Any:
    """IDL files follow one another in a schema, behind lines that are no IDL."""
    kept = [
        line
        for line in text.splitlines()
        if not line.startswith(("=====", "IDL: ")) and not line.startswith("#include")
    ]
    return get_types_from_idl("\n".join(kept))


def _ros1(channel: Channel, _: SourceOptions) -> Decoder:
    kind = channel.message_type
    store = _embedded(get_types_from_msg, channel.definition, kind)
    return Decoder(lambda data: store.deserialize_ros1(data, kind))


def _json(_channel: Channel, _: SourceOptions) -> Decoder:
    return Decoder(lambda data: json.loads(data, object_hook=lambda d: SimpleNamespace(**d)))


def _protobuf(channel: Channel, _: SourceOptions) -> Decoder:
    from google.protobuf import (  # type: ignore[import-untyped]
        descriptor_pb2,
        descriptor_pool,
        message,
        message_factory,
    )

    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(channel.definition)
        pool = descriptor_pool.DescriptorPool()
        for file in files.file:
            pool.Add(file)
        name = channel.message_type.replace("foxglove_msgs/msg/", "foxglove.")
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
    except message.DecodeError as error:
        raise ValueError(str(error)) from error

    def decode(data: bytes) -> Any:
        try:
            return kind.FromString(data)
        except message.DecodeError as error:
            raise ValueError(str(error)) from error

    return Decoder(decode)


def _not_embedded(channel: Channel, options: SourceOptions) -> Decoder:
    """Of several definitions the first that fits a message counts for it."""
    kind = channel.message_type
    stores = [
        store
        for store in _outside_stores(
            kind.partition("/")[0], options.message_paths, options.ros_distro
        )
        if kind in store.fielddefs
    ]
    if not stores:
        raise SourceError(
            f"topic {channel.topic}: the log embeds no definition of {kind} and it is not known. "
            "Give a folder of its .msg files with --msg-path."
        )
    for store in stores:
        _check_whole(store, kind)
    note = f"topic {channel.topic}: the log embeds no definition of {kind}, taken from elsewhere"
    return Decoder(
        partial(_first_that_fits, [partial(_cdr, store, kind) for store in stores]),
        stores[0] if len(stores) == 1 else None,
        note,
    )


def _cdr(store: Typestore, kind: str, data: bytes) -> Any:
    return store.deserialize_cdr(data, kind)


def _first_that_fits(decoders: Sequence[Decode], data: bytes) -> Any:
    *others, last = decoders
    for decode in others:
        try:
            return decode(data)
        except UNDECODABLE:
            continue
    return last(data)


def check_definitions(options: SourceOptions) -> None:
    """See that definitions of the user's are there, whether or not a log needs them.

    Raises:
        UsageError: an option names a release or folder that is not there.
    """
    _release(options.ros_distro)
    for folder in options.message_paths:
        _message_files(folder)


def _release(distro: str | None) -> Stores:
    release = _DISTROS.get(distro or _DEFAULT_DISTRO)
    if release is None:
        raise UsageError(f"--ros-distro {distro} is not known. Choose from {', '.join(_DISTROS)}.")
    return release


@cache
def _outside_stores(
    package: str, message_paths: tuple[Path, ...], distro: str | None
) -> list[Typestore]:
    """Definitions that do not come with a log; those of the user's folders count alone."""
    release = _release(distro)
    own = {name: text for path in message_paths for name, text in _message_files(path).items()}
    alternatives = [own] if any(name.startswith(f"{package}/") for name in own) else None
    stores = []
    for texts in alternatives or KNOWN_DEFINITIONS.get(package, ({},)):
        store = get_typestore(release)
        store.register(_parsed({**own, **texts}, set(store.fielddefs)))
        stores.append(store)
    return stores


def _parsed(texts: dict[str, str], known: set[str]) -> dict[str, Any]:
    types: dict[str, Any] = {}
    for name, text in texts.items():
        if name not in known:
            try:
                types.update(get_types_from_msg(text, name))
            except (TypesysError, ValueError) as error:
                raise UsageError(
                    f"--msg-path: the definition of {name} cannot be used "
                    f"({' '.join(str(error).split())})."
                ) from error
    return types


def _message_files(folder: Path) -> dict[str, str]:
    """Definitions of a folder: `<package>/msg/<Type>.msg` or `<package>/<Type>.msg`."""
    found = {}
    for path in sorted(folder.rglob("*.msg")):
        package = path.parent.parent if path.parent.name == "msg" else path.parent
        found[f"{package.resolve().name}/msg/{path.stem}"] = path.read_text(errors="replace")
    if not found:
        raise UsageError(f"--msg-path {folder}: no .msg files there.")
    return found


_CDR_PARSERS: Final[dict[str, Callable[[str, str], Any]]] = {
    "ros2msg": get_types_from_msg,
    "ros2idl": _types_from_idl,
}
_DECODERS: Final[dict[tuple[str, str], Callable[[Channel, SourceOptions], Decoder]]] = {
    ("cdr", "ros2msg"): _ros2,
    ("cdr", "ros2idl"): _ros2,
    ("cdr", ""): _not_embedded,
    ("ros1", "ros1msg"): _ros1,
    ("protobuf", "protobuf"): _protobuf,
    ("json", "jsonschema"): _json,
    ("json", ""): _json,
}
