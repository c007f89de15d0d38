"""The same messages in every container."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zstandard
from mcap.writer import CompressionType, Writer
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys.store import Typestore

from tests import log_schemas as schemas


@dataclass(frozen=True)
class Logged:
    """A message to be written."""

    topic: str
    kind: str
    log_time_ns: int
    content: Any


def _definition(types: Typestore, kind: str, version: int) -> str:
    return types.generate_msgdef(kind, ros_version=version)[0]


def mcap(
    compression: CompressionType = CompressionType.ZSTD, *, ros: int = 2, **options: Any
) -> Callable[[Path, Sequence[Logged], Typestore], Path]:
    """A bare .mcap file of the profile of ROS 1 or 2; options are those of mcap's writer."""

    def write(path: Path, messages: Sequence[Logged], types: Typestore) -> Path:
        path = path.with_suffix(".mcap")
        with path.open("wb") as file:
            writer = Writer(file, 4096, compression, **options)
            writer.start(profile=f"ros{ros}")
            channels: dict[str, int] = {}
            for message in messages:
                if message.topic not in channels:
                    text = _definition(types, message.kind, ros).encode()
                    name = message.kind if ros == 2 else message.kind.replace("/msg/", "/")
                    schema = writer.register_schema(name, f"ros{ros}msg", text)
                    encoding = "cdr" if ros == 2 else "ros1"
                    channels[message.topic] = writer.register_channel(
                        message.topic, encoding, schema
                    )
                serialize = types.serialize_cdr if ros == 2 else types.serialize_ros1
                data = bytes(serialize(message.content, message.kind))
                time_ns = message.log_time_ns
                writer.add_message(channels[message.topic], time_ns, data, time_ns)
            writer.finish()
        return path

    return write


def encoded(
    message_encoding: str,
    schema_encoding: str,
    schema: Callable[[Typestore, str], bytes],
    encode: Callable[[Typestore, str, Any], bytes],
    rename: Callable[[str], str] = str,
) -> Callable[[Path, Sequence[Logged], Typestore], Path]:
    """A bare .mcap file of no profile with messages of any encoding."""

    def write(path: Path, messages: Sequence[Logged], types: Typestore) -> Path:
        path = path.with_suffix(".mcap")
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            channels: dict[str, int] = {}
            for message in messages:
                if message.topic not in channels:
                    text = schema(types, message.kind)
                    number = writer.register_schema(rename(message.kind), schema_encoding, text)
                    channels[message.topic] = writer.register_channel(
                        message.topic, message_encoding, number
                    )
                data = encode(types, message.kind, message.content)
                time_ns = message.log_time_ns
                writer.add_message(channels[message.topic], time_ns, data, time_ns)
            writer.finish()
        return path

    return write


def _cdr(types: Typestore, kind: str, content: Any) -> bytes:
    return bytes(types.serialize_cdr(content, kind))


def bag(
    compression: rosbag1.Writer.CompressionFormat | None,
    *,
    writers: int = 1,
    chunk_bytes: int | None = None,
) -> Callable[[Path, Sequence[Logged], Typestore], Path]:
    """A ROS 1 bag; several writers of a topic take turns, each with a connection of its own."""

    def write(path: Path, messages: Sequence[Logged], types: Typestore) -> Path:
        path = path.with_suffix(".bag")
        writer = rosbag1.Writer(path)
        if compression is not None:
            writer.set_compression(compression)
        writer.chunk_threshold = chunk_bytes or writer.chunk_threshold
        with writer:
            connections: dict[tuple[str, int], Any] = {}
            for number, message in enumerate(messages):
                key = (message.topic, number % writers)
                if key not in connections:
                    connections[key] = writer.add_connection(
                        message.topic, message.kind, typestore=types, callerid=f"/n{key[1]}"
                    )
                data = types.serialize_ros1(message.content, message.kind)
                writer.write(connections[key], message.log_time_ns, data)
        return path

    return write


def folder(
    plugin: StoragePlugin, mode: CompressionMode = CompressionMode.NONE, version: int = 9
) -> Callable[[Path, Sequence[Logged], Typestore], Path]:
    """A ROS 2 folder; version 8 embeds no definitions in .db3 files."""

    def write(path: Path, messages: Sequence[Logged], types: Typestore) -> Path:
        writer = rosbag2.Writer(path, version=version, storage_plugin=plugin)
        if mode is not CompressionMode.NONE:
            writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            connections: dict[str, Any] = {}
            for message in messages:
                if message.topic not in connections:
                    connections[message.topic] = writer.add_connection(
                        message.topic, message.kind, typestore=types
                    )
                data = types.serialize_cdr(message.content, message.kind)
                writer.write(connections[message.topic], message.log_time_ns, data)
        return path

    return write


def bare_db3(version: int) -> Callable[[Path, Sequence[Logged], Typestore], Path]:
    """A .db3 file without its folder; version 8 embeds no definitions."""

    def write(path: Path, messages: Sequence[Logged], types: Typestore) -> Path:
        whole = folder(StoragePlugin.SQLITE3, version=version)
        [file] = whole(path.with_name(f"{path.name}-folder"), messages, types).glob("*.db3")
        return file.rename(path.with_suffix(".db3"))

    return write


def packed(
    write_log: Callable[[Path, Sequence[Logged], Typestore], Path],
) -> Callable[[Path, Sequence[Logged], Typestore], Path]:
    """A file packed as a whole, without a folder."""

    def write(path: Path, messages: Sequence[Logged], types: Typestore) -> Path:
        file = write_log(path, messages, types)
        target = file.with_name(f"{file.name}.zstd")
        target.write_bytes(zstandard.compress(file.read_bytes()))
        return target

    return write


def split(path: Path, messages: Sequence[Logged], types: Typestore) -> Path:
    """A ROS 2 folder of .mcap files, the messages dealt out in turn, so that times overlap."""
    path.mkdir()
    parts = 11
    for part in range(parts):
        mcap()(path / f"part_{part}", messages[part::parts], types)
    names = "".join(f"    - part_{part}.mcap\n" for part in range(parts))
    (path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n"
        f"  message_count: {len(messages)}\n  relative_file_paths:\n{names}"
    )
    return path


_BAG = rosbag1.Writer.CompressionFormat
ROS2_CONTAINERS = {
    "mcap_zstd": mcap(),
    "mcap_lz4": mcap(CompressionType.LZ4),
    "mcap_none": mcap(CompressionType.NONE),
    "mcap_unchunked": mcap(use_chunking=False),
    "mcap_unindexed": mcap(use_statistics=False, use_summary_offsets=False, repeat_schemas=False),
    "folder_db3": folder(StoragePlugin.SQLITE3),
    "folder_db3_old": folder(StoragePlugin.SQLITE3, version=8),
    "folder_db3_file": folder(StoragePlugin.SQLITE3, CompressionMode.FILE),
    "folder_db3_message": folder(StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    "folder_mcap": folder(StoragePlugin.MCAP),
    "folder_mcap_file": folder(StoragePlugin.MCAP, CompressionMode.FILE),
    "folder_mcap_message": folder(StoragePlugin.MCAP, CompressionMode.MESSAGE),
    "folder_mcap_storage": folder(StoragePlugin.MCAP, CompressionMode.STORAGE),
    "folder_split": split,
    "bare_db3": bare_db3(version=8),
    "bare_db3_defined": bare_db3(version=9),
    "bare_db3_packed": packed(bare_db3(version=9)),
    "bare_mcap_packed": packed(mcap()),
    "mcap_idl": encoded("cdr", "ros2idl", schemas.idl, _cdr),
    "mcap_json": encoded("json", "jsonschema", lambda *_: b"{}", schemas.json_text),
    "mcap_json_bare": encoded("json", "", lambda *_: b"", schemas.json_text),
}
ROS1_CONTAINERS = {
    "bag_none": bag(None),
    "bag_bz2": bag(_BAG.BZ2),
    "bag_lz4": bag(_BAG.LZ4),
    "bag_two_writers": bag(_BAG.LZ4, writers=2, chunk_bytes=4096),
    "mcap_ros1": mcap(ros=1),
}
FOXGLOVE_CONTAINERS = {
    "mcap_protobuf": encoded(
        "protobuf", "protobuf", schemas.protobuf, schemas.protobuf_bytes, schemas.foxglove_name
    ),
    "mcap_foxglove_json": encoded(
        "json", "jsonschema", lambda *_: b"{}", schemas.foxglove_json, schemas.foxglove_name
    ),
}
"""How foxglove's own recorders write its types; all others hold them as ROS messages."""
