"""Encodings and definitions: protobuf, JSON, IDL, and logs that embed no definition."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores

from hbbatch.errors import SourceError, UsageError
from hbbatch.sources.base import SourceOptions
from hbbatch.sources.channels import Channel
from hbbatch.sources.decoding import decoder
from tests import log_families as families
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


@pytest.mark.parametrize("field", ["string[200000000] names", "One[200000000] ones"])
def test_definitions_that_ask_for_code_without_end_are_refused_at_once(field: str) -> None:
    text = f"{field}\n{'=' * 80}\nMSG: my_msgs/One\nint8 a\n"
    channel = Channel("/t", "my_msgs/msg/Box", "cdr", "ros2msg", text.encode())
    with pytest.raises(SourceError, match="its fixed arrays have 200000000 elements"):
        decoder(channel, SourceOptions())
