"""Logs with any bytes changed: never a traceback, never a hang, always a word on what is lost."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from rosbags import rosbag1
from rosbags.typesys import Stores
from rosbags.typesys.store import Typestore

from hbbatch.runner.info import describe_sources
from hbbatch.runner.ingest import ingest
from hbbatch.sources.base import Findings, SourceOptions
from hbbatch.sources.channels import RawMessage
from hbbatch.sources.detect import open_sources
from hbbatch.sources.log import LogSource
from tests import log_families as families
from tests import logs
from tests.bounded import bounded
from tests.log_containers import ROS1_CONTAINERS, ROS2_CONTAINERS, Logged, bag, mcap
from tests.log_families import LoggedFrame

FRAMES = 40
SECOND = 1_000_000_000
_FUZZED = (
    "mcap_zstd",
    "mcap_lz4",
    "mcap_none",
    "mcap_unchunked",
    "mcap_json",
    "mcap_ros1",
    "bag_none",
    "bag_bz2",
    "bag_lz4",
    "bare_db3",
    "folder_db3",
    "folder_db3_message",
    "folder_mcap_file",
    "folder_mcap_message",
    "folder_split",
)


def _frame(number: int) -> LoggedFrame:
    boxes = np.array([[10.0, 2.0, 0.5, 4.0, 2.0, 1.5, 0.3]])
    turn = np.array([0.0, 0.0, 0.0, 1.0])
    place = np.array([number, 0.0, 0.0])
    return LoggedFrame((number + 1) * SECOND, boxes, np.array([0.5]), ["car"], place, turn)


def log_messages(types: Typestore, ros: int) -> list[Logged]:
    """A transform, then a box in its frame, 40 times."""
    family = families.VISION if ros == 2 else families.VISION_ROS1
    tf = "tf2_msgs/msg/TFMessage"
    logged = []
    for frame in map(_frame, range(FRAMES)):
        transform = families.make(types, tf, families.transforms(frame))
        found = families.make(types, family.kind, family.content(frame))
        logged.append(Logged("/tf", tf, frame.time_ns, transform))
        logged.append(Logged("/found", family.kind, frame.time_ns, found))
    return logged


def write(folder: Path, container: str) -> Path:
    ros1 = container in ROS1_CONTAINERS
    release = Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE
    types = families.store(release, vision=int(ros1))
    containers = ROS1_CONTAINERS if ros1 else ROS2_CONTAINERS
    return containers[container](folder / "drive", log_messages(types, 1 if ros1 else 2), types)


@pytest.fixture(scope="module")
def whole_logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("whole")
    paths = {}
    for name in (*_FUZZED, "mcap_idl"):
        (folder / name).mkdir()
        paths[name] = write(folder / name, name)
    return paths


def read(path: Path) -> tuple[list[RawMessage], Findings]:
    [source] = open_sources(path, SourceOptions())
    assert isinstance(source, LogSource)
    findings = Findings()
    blocks = source.log.blocks(lambda _: True, findings)
    return [message for block in blocks for message in block.messages()], findings


_CHANGE = st.one_of(
    st.integers(0, 255).map(lambda value: bytes([value])),
    # Lengths and counts that no file can hold.
    st.sampled_from([2**31 - 1, 2**32 - 1, 2**40, 2**63]).map(lambda n: n.to_bytes(8, "little")),
    st.sampled_from([2**24, 2**28, 2**30 - 1, 2**31]).map(lambda n: n.to_bytes(4, "little")),
)


_DAMAGE = {
    "changes": st.lists(st.tuples(st.floats(0, 1), _CHANGE), min_size=1, max_size=8),
    "kept": st.one_of(st.just(1.0), st.floats(0, 1)),
    "which": st.integers(0, 20),
}
_SETTINGS = settings(
    max_examples=25,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@_SETTINGS
@given(**_DAMAGE)
@example(changes=[(0.046875, b"\x80")], kept=1.0, which=0)
@example(changes=[(0.046875, b"\x22")], kept=1.0, which=0)
@example(changes=[(0.5994605070756228, b"\x01")], kept=1.0, which=0)
@pytest.mark.parametrize("container", _FUZZED)
def test_changed_bytes(
    tmp_path: Path,
    whole_logs: dict[str, Path],
    container: str,
    changes: list[tuple[float, bytes]],
    kept: float,
    which: int,
) -> None:
    """No traceback, no hang, no memory beyond what the file may ask for."""
    _read_spoilt(whole_logs[container], tmp_path, changes, kept, which)


@settings(_SETTINGS, max_examples=5)
@given(**_DAMAGE)
def test_changed_bytes_with_definitions_in_idl(
    tmp_path: Path,
    whole_logs: dict[str, Path],
    changes: list[tuple[float, bytes]],
    kept: float,
    which: int,
) -> None:
    """The same, with fewer examples: parsing IDL takes long."""
    _read_spoilt(whole_logs["mcap_idl"], tmp_path, changes, kept, which)


def _read_spoilt(
    whole: Path, folder: Path, changes: list[tuple[float, bytes]], kept: float, which: int
) -> None:
    path = _copy(whole, folder / "in")
    files = [path] if path.is_file() else sorted(path.iterdir())
    _spoil(files[which % len(files)], changes, kept)
    shutil.rmtree(folder / "out", ignore_errors=True)
    with bounded(cpu_seconds=20, mebibytes=100):
        report = ingest([path], folder / "out")
        info = describe_sources([path], SourceOptions())
    said = [*report.errors, *map(str, info.errors)]
    assert not [text for text in said if "\n" in text or "defect" in text]


def _copy(whole: Path, folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    target = folder / whole.name
    return Path((shutil.copytree if whole.is_dir() else shutil.copy)(whole, target))


def _spoil(file: Path, changes: list[tuple[float, bytes]], kept: float) -> None:
    content = bytearray(file.read_bytes())
    for place, change in changes:
        start = int(place * max(len(content) - len(change), 0))
        content[start : start + len(change)] = change
    file.write_bytes(content[: max(int(kept * len(content)), 1)])


@pytest.mark.parametrize(
    "write_log",
    [
        mcap(CompressionType.ZSTD),
        mcap(CompressionType.NONE),
        mcap(use_chunking=False),
        mcap(use_statistics=False, use_summary_offsets=False, repeat_schemas=False),
    ],
    ids=["zstd", "none", "unchunked", "unindexed"],
)
def test_what_lies_behind_damage_is_read_too(
    tmp_path: Path, write_log: Callable[..., Path]
) -> None:
    """Broken framing in the middle: the length of a record claims more than the file."""
    types = families.store(Stores.ROS2_HUMBLE)
    path = write_log(tmp_path / "drive", log_messages(types, 2), types)
    content = bytearray(path.read_bytes())
    middle = _record_near(content, len(content) // 2, {5, 6})
    content[middle + 1 : middle + 9] = b"\xff" * 8
    path.write_bytes(content)
    messages, findings = read(path)
    times = [message.log_time_ns // SECOND for message in messages]
    assert times[0] == 1
    assert times[-1] == FRAMES
    # A chunk says itself how long it is, so only a bare message is lost; none comes twice.
    assert len(messages) == 2 * FRAMES - (content[middle] == 5)
    assert len(set(zip(times, (m.channel.topic for m in messages), strict=True))) == len(messages)
    assert findings.partial
    assert any("damaged from byte" in problem for problem in findings.problems)


def _record_near(content: bytearray, target: int, opcodes: set[int]) -> int:
    """Where the first top-level record of some kinds behind a place begins."""
    position = 8
    while position < target or content[position] not in opcodes:
        position += 9 + int.from_bytes(content[position + 1 : position + 9], "little")
    return position


@pytest.mark.parametrize("container", ["mcap_zstd", "mcap_none", "mcap_lz4"])
def test_a_chunk_whose_checksum_differs_is_counted(
    tmp_path: Path, whole_logs: dict[str, Path], container: str
) -> None:
    content = bytearray(whole_logs[container].read_bytes())
    middle = _record_near(content, len(content) // 2, {6})
    content[middle + 100] ^= 1
    path = tmp_path / "drive.mcap"
    path.write_bytes(content)
    messages, findings = read(path)
    lost = 2 * FRAMES - len(messages)
    assert 0 < lost < 30
    text = " ".join(findings.problems)
    assert f"{lost} messages of damaged chunks lost" in text
    assert f"declares 80 messages, {len(messages)} were read: {lost} lost" in text
    assert (findings.messages_read, findings.messages_expected) == (len(messages), 80)


def test_damaged_chunk_of_a_bag(tmp_path: Path) -> None:
    types = families.store(Stores.ROS1_NOETIC, vision=1)
    packed = rosbag1.Writer.CompressionFormat.BZ2
    path = bag(packed)(tmp_path / "drive", log_messages(types, 1), types)
    content = bytearray(path.read_bytes())
    place = content.index(b"op=\x05") + 200
    content[place : place + 4] = b"\xff" * 4
    path.write_bytes(content)
    messages, findings = read(path)
    assert findings.partial
    assert findings.messages_expected == 2 * FRAMES > len(messages)


def test_unclosed_bag_is_read_without_index(tmp_path: Path, whole_logs: dict[str, Path]) -> None:
    content = whole_logs["bag_none"].read_bytes()
    path = tmp_path / "drive.bag"
    path.write_bytes(content[: content.index(b"op=\x06") - 60])
    messages, findings = read(path)
    assert len(messages) == 2 * FRAMES
    assert "the bag has no index" in " ".join(findings.problems)


def test_missing_part_of_a_split_recording(tmp_path: Path) -> None:
    types = families.store(Stores.ROS2_HUMBLE)
    path = ROS2_CONTAINERS["folder_split"](tmp_path / "drive", log_messages(types, 2), types)
    gone = path / "part_3.mcap"
    lost = sum(1 for _ in read(gone)[0])
    gone.unlink()
    messages, findings = read(path)
    assert len(messages) == 2 * FRAMES - lost
    assert findings.partial
    assert any("part_3.mcap is listed in metadata.yaml" in problem for problem in findings.problems)
    assert any(f"{lost} lost" in problem for problem in findings.problems)


def test_damaged_db3(tmp_path: Path, whole_logs: dict[str, Path]) -> None:
    content = bytearray(whole_logs["bare_db3"].read_bytes())
    for page in range(8, len(content) // 4096, 5):
        content[page * 4096 : page * 4096 + 100] = b"\xff" * 100
    path = tmp_path / "drive.db3"
    path.write_bytes(content)
    messages, findings = read(path)
    assert 0 < len(messages) <= 2 * FRAMES
    assert findings.partial or len(messages) == 2 * FRAMES


def test_one_channel_that_cannot_be_decoded_costs_only_itself(tmp_path: Path) -> None:
    log = logs.LogWriter()
    item = logs.detection((10, 2, 0.5, 4, 2, 1.5, 0.3), [("car", 0.9)])
    log.add("/found", SECOND, logs.detections(SECOND, "base", [item]))
    log.add("/tf", SECOND, logs.transform(SECOND, "map", "base", (5, 0, 0)))
    log.add("/odom", SECOND, logs.odometry(SECOND, "map", "base", (1, 0, 0)))
    path = log.write(tmp_path / "a.mcap", schema_text={"nav_msgs/msg/Odometry": "%&/ garbage"})
    [source] = open_sources(path, SourceOptions())
    [handle] = source.sequences()
    [reading] = handle.read()
    [batch] = list(reading.batches)
    np.testing.assert_array_equal(batch.poses.translation_m, [[5, 0, 0]])
    assert reading.findings.partial
    assert "topic /odom: the embedded definition" in reading.findings.problems[0]


@pytest.mark.parametrize("container", ["bag_none", "bag_bz2", "bag_lz4"])
def test_a_chunk_of_a_bag_that_claims_a_gigabyte(
    tmp_path: Path, whole_logs: dict[str, Path], container: str
) -> None:
    """What is there is read, and a gigabyte is not asked for."""
    content = bytearray(whole_logs[container].read_bytes())
    start = content.index(b"size=") + 5
    content[start : start + 4] = (2**30 - 1).to_bytes(4, "little")
    path = tmp_path / "drive.bag"
    path.write_bytes(content)
    with bounded(cpu_seconds=20, mebibytes=20):
        messages, findings = read(path)
    assert len(messages) == 2 * FRAMES
    assert (
        f"holds {_chunk_size(whole_logs[container])} bytes of {2**30 - 1}" in findings.problems[0]
    )


def _chunk_size(bag_file: Path) -> int:
    content = bag_file.read_bytes()
    start = content.index(b"size=") + 5
    return int.from_bytes(content[start : start + 4], "little")


@pytest.mark.parametrize("container", ["mcap_zstd", "mcap_lz4", "mcap_none"])
def test_a_chunk_that_claims_a_gigabyte(
    tmp_path: Path, whole_logs: dict[str, Path], container: str
) -> None:
    content = bytearray(whole_logs[container].read_bytes())
    middle = _record_near(content, len(content) // 2, {6})
    content[middle + 25 : middle + 33] = (2**30 - 1).to_bytes(8, "little")
    path = tmp_path / "drive.mcap"
    path.write_bytes(content)
    with bounded(cpu_seconds=20, mebibytes=20):
        messages, findings = read(path)
    assert 0 < len(messages) < 2 * FRAMES
    assert findings.partial
