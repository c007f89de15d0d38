"""ROS 2 bag folders: metadata.yaml with .db3 or .mcap files, split, packed or neither."""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import yaml
import zstandard

from hbbatch.sources.base import Findings
from hbbatch.sources.blocks import Block, MessageLog, Payloads
from hbbatch.sources.channels import Channel, Count, RawMessage, Wanted, file_hash
from hbbatch.sources.mcap import McapLog, is_mcap_file
from hbbatch.sources.sqlite import Db3Log, is_db3_file

_METADATA: Final = "metadata.yaml"
_ROOT: Final = "rosbag2_bagfile_information"
_PACKED: Final = ".zstd", ".zst"
_STORED: Final = (".db3", ".mcap")
_PIECE: Final = 2**20
_LARGEST_MESSAGE: Final = 2**30
_ZSTD_MOST: Final = 2**15
"""Times its own length that a frame of zstd can hold: blocks of 128 KiB from 4 bytes each."""
_ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"


def is_rosbag2_folder(path: Path) -> bool:
    """Whether a path is a folder that rosbag2 wrote.

    Raises:
        OSError: the folder cannot be read.
    """
    return (path / _METADATA).is_file() and bool(_storage_files(path))


def is_packed_log(path: Path) -> bool:
    """Whether a path is a .db3 or .mcap file packed as a whole with zstd.

    Raises:
        OSError: the file cannot be read.
    """
    if not path.is_file() or path.suffix not in _PACKED:
        return False
    with path.open("rb") as file:
        return file.read(4) == _ZSTD_MAGIC and Path(path.stem).suffix in _STORED


@dataclass(frozen=True)
class PackedLog:
    """A .db3 or .mcap file packed as a whole; it is unpacked to a temporary file."""

    path: Path
    format_name: str = "packed_log"

    def profile(self) -> str:
        """What the file inside says."""
        with self._unpacked(Findings()) as log:
            return log.profile() if log else ""

    def channels(self, findings: Findings) -> Sequence[Channel]:
        """Channels of the file inside."""
        with self._unpacked(findings) as log:
            return log.channels(findings) if log else ()

    def blocks(self, wanted: Wanted, findings: Findings) -> Iterator[Block]:
        """Messages of the file inside."""
        with self._unpacked(findings) as log:
            if log:
                yield from log.blocks(wanted, findings)

    def fingerprint(self) -> str:
        """Hash of all bytes of the packed file."""
        return file_hash(self.path)

    @contextmanager
    def _unpacked(self, findings: Findings) -> Iterator[MessageLog | None]:
        with tempfile.TemporaryDirectory(prefix="hbbatch-") as folder:
            target = Path(folder) / unpacked_name(self.path)
            _unpack(self.path, target, findings)
            log = open_storage(target)
            if log is None:
                findings.lost(f"{self.path.name} holds neither a .db3 nor a .mcap file")
            yield log


def unpacked_name(path: Path) -> str:
    """Name of a storage file without the ending of its packing."""
    return path.stem if path.suffix in _PACKED else path.name


def log_stem(path: Path) -> str:
    """What the sequence of a log is named after: its file name without endings, or its folder."""
    return path.name if path.is_dir() else Path(unpacked_name(path)).stem


def _unpack(source: Path, target: Path, findings: Findings) -> None:
    with source.open("rb") as packed, target.open("wb") as file:
        try:
            with zstandard.ZstdDecompressor().stream_reader(packed) as reader:
                while piece := reader.read(_PIECE):
                    file.write(piece)
        except zstandard.ZstdError as error:
            findings.lost(f"{source.name} cannot be unpacked to its end ({error})")


def open_storage(path: Path) -> MessageLog | None:
    """The log in a storage file, by its content; None when it is none."""
    openers: tuple[tuple[Callable[[Path], bool], Callable[[Path], MessageLog]], ...] = (
        (is_mcap_file, McapLog),
        (is_db3_file, Db3Log),
        (is_packed_log, PackedLog),
    )
    return next((make(path) for recognises, make in openers if recognises(path)), None)


@dataclass(frozen=True)
class Rosbag2Log:
    """A folder that rosbag2 wrote. Its files are opened themselves, whatever the metadata says."""

    path: Path
    format_name: str = "rosbag2"

    def profile(self) -> str:
        """Folders know of one system only."""
        return "ros2"

    def channels(self, findings: Findings) -> Sequence[Channel]:
        """Channels of all files, each once."""
        met = {c: None for log in self._logs(findings) for c in log.channels(findings)}
        return list(met)

    def blocks(self, wanted: Wanted, findings: Findings) -> Iterator[Block]:
        """Messages of all files, one file after the other."""
        metadata = _metadata(self.path, findings)
        unpack = str(metadata.get("compression_mode")).upper() == "MESSAGE"
        for log in self._logs(findings):
            met = Findings()
            for block in log.blocks(wanted, met):
                yield _unpacked_block(block, met) if unpack else block
            findings.adopt(met, log.path.name)
        declared = metadata.get("message_count")
        if isinstance(declared, int):
            Count(findings.messages_read, declared).report(findings, _METADATA)

    def fingerprint(self) -> str:
        """Hash of all its files."""
        paths = [self.path / _METADATA, *_storage_files(self.path)]
        hashes = [(path.name, file_hash(path)) for path in paths]
        return hashlib.sha256(repr(hashes).encode()).hexdigest()

    def _logs(self, findings: Findings) -> Iterator[MessageLog]:
        files = _storage_files(self.path)
        _compare_names(_metadata(self.path, Findings()), files, findings)
        for path in files:
            log = open_storage(path)
            if log is None:
                findings.lost(f"{path.name} is neither a .db3 nor a .mcap file: not read")
            else:
                yield log


def _storage_files(folder: Path) -> list[Path]:
    """Files of a folder that may hold messages, in the order of the numbers in their names."""
    files = [
        entry
        for entry in folder.iterdir()
        if entry.is_file() and Path(unpacked_name(entry)).suffix in _STORED
    ]
    return sorted(files, key=_natural)


def _natural(path: Path) -> list[tuple[int, str]]:
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdecimal() else (0, part) for part in parts]


def _metadata(folder: Path, findings: Findings) -> dict[str, Any]:
    """The metadata; empty, and noted, when it cannot be used. The files count in any case."""
    try:
        content = yaml.safe_load((folder / _METADATA).read_text(errors="replace"))
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        findings.note(f"{_METADATA} cannot be read ({' '.join(str(error).split())}); not used")
        return {}
    inner = content.get(_ROOT) if isinstance(content, dict) else None
    if not isinstance(inner, dict):
        findings.note(f"{_METADATA} has no {_ROOT}; not used")
        return {}
    return inner


def _compare_names(metadata: dict[str, Any], files: Sequence[Path], findings: Findings) -> None:
    listed = metadata.get("relative_file_paths")
    names = {Path(str(name)).name for name in listed} if isinstance(listed, list) else set()
    # rosbag2 lists a packed file with or without the ending of its packing.
    there = {path.name for path in files} | {unpacked_name(path) for path in files}
    for name in sorted(names - there):
        findings.lost(f"{name} is listed in {_METADATA} and not there: its messages are lost")
    for path in files:
        if names and not {path.name, unpacked_name(path)} & names:
            findings.note(f"{path.name} is not listed in {_METADATA}; read all the same")


def _unpacked_block(block: Block, findings: Findings) -> Block:
    messages = [_unpacked_message(message, findings) for message in block.messages()]
    payloads = Payloads.of([message.data for message in messages])
    return replace(block, payloads=payloads)


def _unpacked_message(message: RawMessage, findings: Findings) -> RawMessage:
    """A message that was packed by itself; one that cannot be unpacked stays as it is."""
    try:
        most = min(_LARGEST_MESSAGE, _ZSTD_MOST * len(message.data))
        size = min(max(zstandard.frame_content_size(message.data), 0), most)
        unpacked = zstandard.ZstdDecompressor().decompress(message.data, max_output_size=size)
    except (zstandard.ZstdError, MemoryError) as error:
        problem = f"topic {message.channel.topic}: packed messages cannot be unpacked ({error})"
        if problem not in findings.problems:
            findings.lost(problem)
        return message
    return message._replace(data=unpacked)
