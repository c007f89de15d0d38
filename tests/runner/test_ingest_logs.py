"""Every message family in every container gives the same tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from rosbags.typesys import Stores
from rosbags.typesys.store import Typestore

from hbbatch.dataset import Dataset
from hbbatch.errors import ExitStatus
from hbbatch.runner.ingest import ingest
from hbbatch.sources.base import SourceOptions
from hbbatch.sources.kitti import KittiSource
from tests import log_families as families
from tests.frames import frames_of
from tests.log_containers import ROS1_CONTAINERS, ROS2_CONTAINERS, Logged
from tests.log_families import Family, LoggedFrame

_CLASSES = ("car", "pedestrian", "bicycle")
_START_NS = 1_700_000_000_000_000_000
_BOX = ("x", "y", "z", "length", "width", "height", "yaw")
Write = Callable[[Path, Sequence[Logged], Typestore], Path]


@cache
def _store(release: Stores, vision: int = 0) -> Typestore:
    return families.store(release, vision)


@pytest.fixture(scope="module")
def real_frames(test_data: Path) -> list[LoggedFrame]:
    """A few frames of KITTI; classes that every family knows, scores that are eighths."""
    found = SourceOptions(test_data / "kitti/detections/virconv/training")
    [reading] = KittiSource(test_data / "kitti/training", found).sequences()[0].read()
    return [
        LoggedFrame(
            _START_NS + frame.timestamp_ns,
            frame.boxes,
            np.arange(1, len(frame.boxes) + 1) % 8 / 8,
            [_CLASSES[row % len(_CLASSES)] for row in range(len(frame.boxes))],
            frame.pose.translation_m,
            frame.pose.rotation,
        )
        for frame in frames_of(reading)[:6]
    ]


def messages(family: Family, frames: Sequence[LoggedFrame], types: Typestore) -> list[Logged]:
    """Detections, and transforms that come after the data they explain."""
    tf = "tf2_msgs/msg/TFMessage"
    detections = [
        Logged(
            "/found",
            family.kind,
            f.time_ns + 5,
            families.make(types, family.kind, family.content(f)),
        )
        for f in frames
    ]
    return detections + [
        Logged("/tf", tf, f.time_ns + 9, families.make(types, tf, families.transforms(f)))
        for f in frames
    ]


def check(
    path: Path, family: Family, frames: Sequence[LoggedFrame], out: Path, log_offset_ns: int = 5
) -> None:
    """Ingest a log and hold its tables against the frames, to the bit where the family has them."""
    report = ingest([path], out)
    assert report.errors == []
    assert report.exit_status is ExitStatus.DONE
    [outcome] = report.outcomes
    dataset = Dataset.open(out)
    found, poses = dataset.detections(outcome.sequence_id), dataset.poses(outcome.sequence_id)
    assert poses["timestamp_ns"].to_pylist() == [f.time_ns for f in frames]
    assert poses["log_time_ns"].to_pylist() == [f.time_ns + log_offset_ns for f in frames]
    assert set(poses["origin"].to_pylist()) == {"logged"}
    assert set(poses["frame_id"].to_pylist()) == {families.FRAME_ID}
    for axis, name in enumerate("xyz"):
        expected = [f.translation_m[axis] for f in frames]
        np.testing.assert_array_equal(poses[f"translation_{name}"], expected)
    _check_boxes(found, family, frames)


def _check_boxes(found: pa.Table, family: Family, frames: Sequence[LoggedFrame]) -> None:
    boxes = np.concatenate([f.boxes for f in frames])
    for column, name in enumerate(_BOX[:6]):
        np.testing.assert_array_equal(found[name], boxes[:, column])
    # A yaw that went through half angles has lost its last bits.
    np.testing.assert_allclose(found["yaw"], boxes[:, 6], rtol=0, atol=1e-15 * 8)
    scores = np.concatenate([f.scores for f in frames])
    expected = {0: np.ones(len(scores)), 8: np.rint(scores * 255) / 255}.get(family.scored, scores)
    np.testing.assert_array_equal(found["score"], expected)
    spelled = family.classes or {}
    names = [spelled.get(name, name) for f in frames for name in f.names]
    assert found["class_name_logged"].to_pylist() == names


@pytest.mark.parametrize("container", ROS2_CONTAINERS)
def test_vision_messages_of_ros2(
    tmp_path: Path, real_frames: list[LoggedFrame], container: str
) -> None:
    types = _store(Stores.ROS2_HUMBLE)
    log = messages(families.VISION, real_frames, types)
    path = ROS2_CONTAINERS[container](tmp_path / "drive", log, types)
    check(path, families.VISION, real_frames, tmp_path / "out")


@pytest.mark.parametrize("container", ["mcap_zstd", "folder_db3_old"])
def test_vision_messages_of_foxy(
    tmp_path: Path, real_frames: list[LoggedFrame], container: str
) -> None:
    types = _store(Stores.ROS2_FOXY, vision=1)
    log = messages(families.VISION_FOXY, real_frames, types)
    path = ROS2_CONTAINERS[container](tmp_path / "drive", log, types)
    check(path, families.VISION_FOXY, real_frames, tmp_path / "out")


@pytest.mark.parametrize("container", ROS1_CONTAINERS)
def test_vision_messages_of_ros1(
    tmp_path: Path, real_frames: list[LoggedFrame], container: str
) -> None:
    types = _store(Stores.ROS1_NOETIC, vision=1)
    log = messages(families.VISION_ROS1, real_frames, types)
    path = ROS1_CONTAINERS[container](tmp_path / "drive", log, types)
    check(path, families.VISION_ROS1, real_frames, tmp_path / "out")


@pytest.mark.parametrize("family", families.FAMILIES, ids=lambda f: f.kind.replace("/msg/", "-"))
@pytest.mark.parametrize("container", ["mcap_zstd", "folder_db3", "bare_db3", "folder_mcap"])
def test_other_families_of_ros2(
    tmp_path: Path, real_frames: list[LoggedFrame], family: Family, container: str
) -> None:
    if container == "bare_db3" and family.kind.startswith("foxglove"):
        pytest.skip("hbbatch registers no definition of foxglove_msgs")
    types = _store(Stores.ROS2_HUMBLE)
    path = ROS2_CONTAINERS[container](
        tmp_path / "drive", messages(family, real_frames, types), types
    )
    check(path, family, real_frames, tmp_path / "out")


@pytest.mark.parametrize("family", families.FAMILIES, ids=lambda f: f.kind.replace("/msg/", "-"))
@pytest.mark.parametrize("container", ["bag_lz4", "mcap_ros1"])
def test_other_families_of_ros1(
    tmp_path: Path, real_frames: list[LoggedFrame], family: Family, container: str
) -> None:
    types = _store(Stores.ROS1_NOETIC, vision=1)
    path = ROS1_CONTAINERS[container](
        tmp_path / "drive", messages(family, real_frames, types), types
    )
    check(path, family, real_frames, tmp_path / "out")


def test_containers_give_the_same_tables_to_the_last_bit(
    tmp_path: Path, real_frames: list[LoggedFrame]
) -> None:
    types = _store(Stores.ROS2_HUMBLE)
    log = messages(families.VISION, real_frames, types)
    tables: list[Any] = []
    for name, write in ROS2_CONTAINERS.items():
        (tmp_path / name).mkdir()
        path = write(tmp_path / name / "drive", log, types)
        ingest([path], tmp_path / name / "out")
        dataset = Dataset.open(tmp_path / name / "out")
        found = dataset.detections("drive").drop_columns(["source_row"])
        tables.append((found, dataset.poses("drive")))
    for found, poses in tables[1:]:
        assert found.equals(tables[0][0])
        assert poses.equals(tables[0][1])
