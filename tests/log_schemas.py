"""Definitions and bytes of messages in the encodings that rosbags does not write."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore


def _held(types: Typestore, kind: str) -> list[str]:
    """A type behind all types that it holds, each once and behind those that it holds itself."""
    inner = [name for _, field in types.fielddefs[kind][1] for name in _named(field)]
    return list(dict.fromkeys([*(name for i in inner for name in _held(types, i)), kind]))


def _named(field: Any) -> Iterator[str]:
    node, argument = field
    if node == Nodetype.NAME:
        yield argument
    elif node != Nodetype.BASE:
        yield from _named(argument[0])


# --- IDL ----------------------------------------------------------------------------------------

_IDL = {"bool": "boolean", "byte": "octet", "float32": "float", "float64": "double"}


def idl(types: Typestore, kind: str) -> bytes:
    """As rosidl writes IDL, and recorders join it: each file behind a line and its name."""
    line = "=" * 80
    files = [f"{line}\nIDL: {name}\n{_idl_file(types, name)}" for name in _held(types, kind)[::-1]]
    return "".join(files).encode()


def _idl_file(types: Typestore, kind: str) -> str:
    package, _, name = kind.split("/")
    held = dict.fromkeys(inner for _, field in types.fielddefs[kind][1] for inner in _named(field))
    includes = "".join(f'#include "{inner}.idl"\n' for inner in held)
    aliases: dict[str, str] = {}
    fields = [
        f"      {_idl_type(field, aliases)} {label};" for label, field in types.fielddefs[kind][1]
    ]
    typedefs = [f"    typedef {text};" for text in aliases.values()]
    comment = '    @verbatim (language="comment", text=\n      "What it is.")'
    body = [f"module {package} {{", "  module msg {", *typedefs, comment, f"    struct {name} {{"]
    return f"// generated\n{includes}" + "\n".join([*body, *fields, "    };", "  };", "};", ""])


def _idl_type(field: Any, aliases: dict[str, str]) -> str:
    node, argument = field
    if node == Nodetype.NAME:
        return str(argument).replace("/", "::")
    if node == Nodetype.BASE:
        return _IDL.get(argument[0], argument[0])
    inner = _idl_type(argument[0], aliases)
    if node == Nodetype.SEQUENCE:
        return f"sequence<{inner}>"
    alias = f"{inner.replace('::', '__')}__{argument[1]}"
    aliases[alias] = f"{inner} {alias}[{argument[1]}]"
    return alias


# --- JSON ---------------------------------------------------------------------------------------


def plain(message: Any) -> Any:
    """A message as nested dictionaries and lists."""
    if isinstance(message, list):
        return [plain(item) for item in message]
    if hasattr(message, "__msgtype__"):
        fields = vars(message).items()
        return {name: plain(value) for name, value in fields if name != "__msgtype__"}
    return message


def json_text(_: Typestore, _kind: str, message: Any) -> bytes:
    """A message with the field names of ROS."""
    return json.dumps(plain(message), default=_number).encode()


def foxglove_json(_: Typestore, _kind: str, message: Any) -> bytes:
    """A message as foxglove spells it: times are `sec` and `nsec`."""
    return json.dumps(_retimed(plain(message), ("sec", "nsec")), default=_number).encode()


def _number(value: Any) -> Any:
    return value.tolist()


def _retimed(content: Any, names: tuple[str, str]) -> Any:
    """Times and durations with other names of their two fields."""
    if isinstance(content, list):
        return [_retimed(item, names) for item in content]
    if not isinstance(content, dict):
        return content
    if content.keys() == {"sec", "nanosec"}:
        return dict(zip(names, content.values(), strict=True))
    return {name: _retimed(value, names) for name, value in content.items()}


# --- protobuf -----------------------------------------------------------------------------------

_PROTOBUF = {
    "float64": 1,
    "float32": 2,
    "int64": 3,
    "int32": 5,
    "uint32": 13,
    "uint8": 13,
    "bool": 8,
    "string": 9,
    "bytes": 12,
    "message": 11,
}
_WELL_KNOWN = {
    "builtin_interfaces/msg/Time": "google.protobuf.Timestamp",
    "builtin_interfaces/msg/Duration": "google.protobuf.Duration",
}


def foxglove_name(kind: str) -> str:
    """How foxglove calls a type in protobuf and JSON."""
    package, _, name = kind.split("/")
    assert package in {"foxglove_msgs", "geometry_msgs"}
    return f"foxglove.{'Point3' if name == 'Point' else name}"


def protobuf(types: Typestore, kind: str) -> bytes:
    """A FileDescriptorSet of a foxglove type, its fields numbered in order as foxglove's are."""
    return bytes(_descriptors(types, kind).SerializeToString())


def protobuf_bytes(types: Typestore, kind: str, message: Any) -> bytes:
    """A message of a foxglove type."""
    pool = descriptor_pool.DescriptorPool()
    for file in _descriptors(types, kind).file:
        pool.Add(file)
    made = message_factory.GetMessageClass(pool.FindMessageTypeByName(foxglove_name(kind)))
    content = _retimed(plain(message), ("seconds", "nanos"))
    return bytes(made(**_unarrayed(content)).SerializeToString())


def _unarrayed(content: Any) -> Any:
    if isinstance(content, dict):
        return {name: _unarrayed(value) for name, value in content.items()}
    if isinstance(content, list):
        return [_unarrayed(item) for item in content]
    if hasattr(content, "tobytes"):
        return content.tobytes() if content.dtype == "uint8" else content.tolist()
    return content


def _protobuf_name(kind: str) -> str:
    return _WELL_KNOWN.get(kind) or foxglove_name(kind)


def _descriptors(types: Typestore, kind: str) -> descriptor_pb2.FileDescriptorSet:
    files = descriptor_pb2.FileDescriptorSet()
    for held in _held(types, kind):
        name = _protobuf_name(held)
        package, _, short = name.rpartition(".")
        file = files.file.add(name=f"{name}.proto", package=package, syntax="proto3")
        message = file.message_type.add(name=short)
        fields = types.fielddefs[held][1]
        if held in _WELL_KNOWN:
            base = [(Nodetype.BASE, ("int64", 0)), (Nodetype.BASE, ("int32", 0))]
            fields = list(zip(("seconds", "nanos"), base, strict=True))
        for number, (label, field) in enumerate(fields, 1):
            _add_field(message, file, number, label, field)
    return files


def _add_field(message: Any, file: Any, number: int, label: str, field: Any) -> None:
    node, argument = field
    repeated = node in (Nodetype.ARRAY, Nodetype.SEQUENCE)
    inner = argument[0] if repeated else field
    of_bytes = repeated and inner[0] == Nodetype.BASE and inner[1][0] == "uint8"
    made = message.field.add(name=label, number=number, label=3 if repeated else 1)
    if of_bytes:
        made.label, made.type = 1, _PROTOBUF["bytes"]
    elif inner[0] == Nodetype.NAME:
        name = _protobuf_name(inner[1])
        made.type, made.type_name = _PROTOBUF["message"], f".{name}"
        if f"{name}.proto" not in file.dependency:
            file.dependency.append(f"{name}.proto")
    else:
        made.type = _PROTOBUF[inner[1][0]]
