"""Encodings and definitions: protobuf, JSON, IDL, and logs that embed no definition."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import Writer
from rosbags.typesys import Stores

from hbbatch.errors import SourceError, UsageError
from hbbatch.sources.base import SourceOptions
from hbbatch.sources.channels import Channel
from hbbatch.sources.decoding import decoder
from hbbatch.sources.detect import open_sources
from tests import log_families as families
from tests.frames import Frame, frames_of
from tests.log_families import LoggedFrame

SECOND = 1_000_000_000
FRAME = LoggedFrame(
    5 * SECOND + 7,
    np.array([[1.0, 2.0, 3.0, 4.0, 2.0, 1.5, 0.5], [9.0, 8.0, 7.0, 1.0, 1.0, 2.0, -1.0]]),
    np.array([0.5, 0.25]),
    ["car", "pedestrian"],
    np.zeros(3),
    np.array([0.0, 0.0, 0.0, 1.0]),
)
_KINDS = {"double": 1, "string": 9, "int64": 3, "int32": 5, "message": 11}
_SCENE = {
    "google.protobuf.Timestamp": [("seconds", 1, "int64"), ("nanos", 2, "int32")],
    "foxglove.Vector3": [(axis, n + 1, "double") for n, axis in enumerate("xyz")],
    "foxglove.Quaternion": [(axis, n + 1, "double") for n, axis in enumerate("xyzw")],
    "foxglove.Pose": [
        ("position", 1, "foxglove.Vector3"),
        ("orientation", 2, "foxglove.Quaternion"),
    ],
    "foxglove.KeyValuePair": [("key", 1, "string"), ("value", 2, "string")],
    "foxglove.CubePrimitive": [("pose", 1, "foxglove.Pose"), ("size", 2, "foxglove.Vector3")],
    "foxglove.SceneEntity": [
        ("timestamp", 1, "google.protobuf.Timestamp"),
        ("frame_id", 2, "string"),
        ("id", 3, "string"),
        ("metadata", 6, "*foxglove.KeyValuePair"),
        ("cubes", 8, "*foxglove.CubePrimitive"),
    ],
    "foxglove.SceneUpdate": [("entities", 2, "*foxglove.SceneEntity")],
}
"""The fields that matter here, numbered as foxglove numbers them."""


def descriptors() -> descriptor_pb2.FileDescriptorSet:
    files = descriptor_pb2.FileDescriptorSet()
    for name, fields in _SCENE.items():
        package, _, short = name.rpartition(".")
        file = files.file.add(name=f"{name}.proto", package=package, syntax="proto3")
        message = file.message_type.add(name=short)
        for field, number, kind in fields:
            plain = kind.removeprefix("*")
            made = message.field.add(name=field, number=number, label=3 if "*" in kind else 1)
            made.type = _KINDS.get(plain, _KINDS["message"])
            if "." in plain:
                made.type_name = f".{plain}"
                file.dependency.append(f"{plain}.proto")
    return files


def write(path: Path, name: str, encodings: tuple[str, str], schema: bytes, data: bytes) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema_id = writer.register_schema(name, encodings[1], schema)
        channel = writer.register_channel("/scene", encodings[0], schema_id)
        writer.add_message(channel, 1, data, 1)
        writer.finish()
    return path


def read(path: Path, options: SourceOptions | None = None) -> Frame:
    [source] = open_sources(path, options or SourceOptions())
    [handle] = source.sequences()
    [reading] = handle.read()
    [frame] = frames_of(reading)
    return frame


def check(frame: Frame) -> None:
    assert frame.timestamp_ns == FRAME.time_ns
    assert frame.frame_id == families.FRAME_ID
    np.testing.assert_allclose(frame.boxes, FRAME.boxes, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(frame.scores, FRAME.scores)
    assert frame.class_names == FRAME.names


def _with(content: dict[str, Any], seconds: str, nanoseconds: str) -> dict[str, Any]:
    """The stamps of entities as another encoding names them."""
    for entity in content["entities"]:
        stamp = entity["timestamp"]
        entity["timestamp"] = {seconds: stamp["sec"], nanoseconds: stamp["nanosec"]}
    return content


def test_protobuf(tmp_path: Path) -> None:
    files = descriptors()
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("foxglove.SceneUpdate"))
    message = kind(**_with(families.scene(FRAME), "seconds", "nanos"))
    encodings = ("protobuf", "protobuf")
    schema, data = files.SerializeToString(), message.SerializeToString()
    check(read(write(tmp_path / "a.mcap", "foxglove.SceneUpdate", encodings, schema, data)))


@pytest.mark.parametrize("schema", [b"{}", b""])
def test_json(tmp_path: Path, schema: bytes) -> None:
    data = families.plain_json(_with(families.scene(FRAME), "sec", "nsec"))
    encodings = ("json", "jsonschema")
    check(read(write(tmp_path / "a.mcap", "foxglove.SceneUpdate", encodings, schema, data)))


def test_json_of_a_ros_type(tmp_path: Path) -> None:
    content = families.make(
        families.store(Stores.ROS2_HUMBLE), families.VISION.kind, families.vision(FRAME)
    )
    data = families.plain_json(_plain(content))
    name = "vision_msgs/msg/Detection3DArray"
    check(read(write(tmp_path / "a.mcap", name, ("json", "jsonschema"), b"{}", data)))


def _plain(message: Any) -> Any:
    if isinstance(message, list):
        return [_plain(item) for item in message]
    if hasattr(message, "__msgtype__"):
        return {name: _plain(value) for name, value in vars(message).items()}
    return message


_IDL_HEADER = """module std_msgs { module msg {
  struct Header { builtin_interfaces::msg::Time stamp; string frame_id; };
}; };
"""
_IDL_TIME = """module builtin_interfaces { module msg {
  struct Time { long sec; unsigned long nanosec; };
}; };
"""


def test_idl_definitions() -> None:
    line = "=" * 80
    text = (
        f'{line}\nIDL: std_msgs/msg/Header\n#include "builtin_interfaces/msg/Time.idl"\n'
        f"{_IDL_HEADER}{line}\nIDL: builtin_interfaces/msg/Time\n{_IDL_TIME}"
    )
    channel = Channel("/h", "std_msgs/msg/Header", "cdr", "ros2idl", text.encode())
    types = families.store(Stores.ROS2_HUMBLE)
    header = families.make(types, "std_msgs/msg/Header", families.header(FRAME))
    data = bytes(types.serialize_cdr(header, "std_msgs/msg/Header"))
    message = decoder(channel, SourceOptions()).decode(data)
    assert (message.stamp.sec, message.stamp.nanosec) == (5, 7)
    assert message.frame_id == families.FRAME_ID


def bare(kind: str) -> Channel:
    return Channel("/t", kind, "cdr", "", b"")


def test_unknown_type_without_definition_says_what_to_do() -> None:
    with pytest.raises(SourceError, match=r"topic /t: .*my_msgs/msg/Box.*--msg-path"):
        decoder(bare("my_msgs/msg/Box"), SourceOptions())


def test_definitions_from_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Box.msg").write_text("std_msgs/Header header\nuint8 kind\n")
    options = SourceOptions(message_paths=(tmp_path,))
    made = decoder(bare("my_msgs/msg/Box"), options)
    # Encapsulation, stamp, the text "a", then the byte.
    data = bytes([0, 1, 0, 0, 5, 0, 0, 0, 7, 0, 0, 0, 2, 0, 0, 0, 97, 0, 9])
    assert made.decode(data).kind == 9
    assert "embeds no definition of my_msgs/msg/Box" in made.note


def test_ros_distro_that_is_not_known() -> None:
    with pytest.raises(UsageError, match=r"--ros-distro noble is not known. Choose from .*humble"):
        decoder(bare("std_msgs/msg/Header"), SourceOptions(ros_distro="noble"))


def test_encoding_that_is_not_known() -> None:
    with pytest.raises(SourceError, match=r"topic /t: messages are cbor with no definition"):
        decoder(Channel("/t", "x/msg/Y", "cbor", "", b""), SourceOptions())
