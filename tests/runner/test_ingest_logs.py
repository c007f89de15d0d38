"""Every message family in every container gives the same tables, to the last bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from math import atan2
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from rosbags.typesys import Stores
from rosbags.typesys.store import Typestore

from hbbatch.boxes import FloatArray
from hbbatch.dataset import Dataset
from hbbatch.errors import ExitStatus
from hbbatch.runner.ingest import ingest
from hbbatch.sources.base import SourceOptions
from hbbatch.sources.kitti import KittiSource
from tests import log_families as families
from tests.frames import frames_of
from tests.log_containers import (
    FOXGLOVE_CONTAINERS,
    ROS1_CONTAINERS,
    ROS2_CONTAINERS,
    Logged,
)
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
    """A few frames of KITTI; classes that every family knows, scores that need all 64 bits."""
    found = SourceOptions(test_data / "kitti/detections/virconv/training")
    [reading] = KittiSource(test_data / "kitti/training", found).sequences()[0].read()
    return [
        LoggedFrame(
            _START_NS + frame.timestamp_ns,
            frame.boxes,
            (np.arange(len(frame.boxes)) % 8 + 1) / 10,
            [_CLASSES[row % len(_CLASSES)] for row in range(len(frame.boxes))],
            frame.pose.translation_m,
            frame.pose.rotation,
        )
        for frame in frames_of(reading)[:6]
    ]


def messages(family: Family, frames: Sequence[LoggedFrame], types: Typestore) -> list[Logged]:
    """Detections, and transforms that come after the data they explain."""
    kind, transforms = family.poses
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
        Logged("/tf", kind, f.time_ns + 9, families.make(types, kind, transforms(f)))
        for f in frames
    ]


def ingested(path: Path, out: Path) -> tuple[pa.Table, pa.Table]:
    """Detections and poses of a log that is read without a word."""
    report = ingest([path], out)
    assert report.errors == []
    assert report.exit_status is ExitStatus.DONE
    [outcome] = report.outcomes
    dataset = Dataset.open(out)
    return dataset.detections(outcome.sequence_id), dataset.poses(outcome.sequence_id)


def in_all_containers(
    folder: Path,
    family: Family,
    frames: Sequence[LoggedFrame],
    containers: Mapping[str, Write],
    types: Typestore,
) -> tuple[pa.Table, pa.Table]:
    """The tables of a family, which are the same to the last bit whatever the container."""
    log = messages(family, frames, types)
    first: tuple[pa.Table, pa.Table] | None = None
    for name, write in containers.items():
        (folder / name).mkdir(parents=True)
        found, poses = ingested(write(folder / name / "drive", log, types), folder / name / "out")
        first = first or (found, poses)
        assert found.equals(first[0]), name
        assert poses.equals(first[1]), name
    assert first is not None
    check_boxes(first[0], family, frames)
    check_poses(first[1], frames)
    return first


def check_poses(poses: pa.Table, frames: Sequence[LoggedFrame]) -> None:
    assert poses["timestamp_ns"].to_pylist() == [f.time_ns for f in frames]
    assert poses["log_time_ns"].to_pylist() == [f.time_ns + 5 for f in frames]
    assert set(poses["origin"].to_pylist()) == {"logged"}
    assert set(poses["frame_id"].to_pylist()) == {families.FRAME_ID}
    for axis, name in enumerate("xyz"):
        expected = [f.translation_m[axis] for f in frames]
        np.testing.assert_array_equal(poses[f"translation_{name}"], expected)


def check_boxes(found: pa.Table, family: Family, frames: Sequence[LoggedFrame]) -> None:
    """Values to the bit where the family has them."""
    boxes = np.concatenate([f.boxes for f in frames])
    for column, name in enumerate(_BOX[:6]):
        np.testing.assert_array_equal(found[name], boxes[:, column])
    np.testing.assert_array_equal(found["yaw"], _sent_yaw(boxes[:, 6], family))
    # What a quaternion's four numbers hold of an angle.
    np.testing.assert_allclose(found["yaw"], boxes[:, 6], rtol=0, atol=1e-15)
    scores = np.concatenate([f.scores for f in frames])
    expected = {
        0: np.ones(len(scores)),
        8: np.rint(scores * 255) / 255,
        32: scores.astype(np.float32).astype(np.float64),
        64: scores,
    }
    np.testing.assert_array_equal(found["score"], expected[family.scored])
    spelled = family.classes or {}
    names = [spelled.get(name, name) for f in frames for name in f.names]
    assert found["class_name_logged"].to_pylist() == names


def _sent_yaw(yaw: FloatArray, family: Family) -> FloatArray:
    """The yaw that follows from the numbers sent: a quaternion about z, or a velocity."""
    if family.course:
        return np.array([atan2(10 * np.sin(angle), 10 * np.cos(angle)) for angle in yaw])
    z, w = np.sin(yaw / 2), np.cos(yaw / 2)
    return np.arctan2(2 * w * z, w * w - z * z)


def test_vision_messages_of_ros2(tmp_path: Path, real_frames: list[LoggedFrame]) -> None:
    types = _store(Stores.ROS2_HUMBLE)
    in_all_containers(tmp_path, families.VISION, real_frames, ROS2_CONTAINERS, types)


def test_vision_messages_of_foxy(tmp_path: Path, real_frames: list[LoggedFrame]) -> None:
    types = _store(Stores.ROS2_FOXY, vision=1)
    in_all_containers(tmp_path, families.VISION_FOXY, real_frames, ROS2_CONTAINERS, types)


def test_vision_messages_of_ros1(tmp_path: Path, real_frames: list[LoggedFrame]) -> None:
    types = _store(Stores.ROS1_NOETIC, vision=1)
    in_all_containers(tmp_path, families.VISION_ROS1, real_frames, ROS1_CONTAINERS, types)


@pytest.mark.parametrize("container", ["bag_two_writers", "mcap_ros1"])
def test_order_in_the_file_does_not_matter(
    tmp_path: Path, real_frames: list[LoggedFrame], container: str
) -> None:
    """Chunks that are not sorted by time; of one writer, or of two that take turns."""
    types = _store(Stores.ROS1_NOETIC, vision=1)
    log = messages(families.VISION_ROS1, real_frames, types)
    write = ROS1_CONTAINERS[container]
    tables, backwards = [], []
    for name, part in {"sorted": log, "unsorted": log[::-1]}.items():
        report = ingest([write(tmp_path / name, part, types)], tmp_path / "out")
        assert report.exit_status is ExitStatus.DONE
        dataset = Dataset.open(tmp_path / "out")
        found = dataset.detections(name).drop_columns(["source_row"])
        tables.append((found, dataset.poses(name)))
        backwards.append([p for o in report.outcomes for p in o.problems if "backwards" in p])
    assert tables[1][0].equals(tables[0][0])
    assert tables[1][1].equals(tables[0][1])
    assert backwards == [[], ["topic /found: stamps run backwards 5 times, sorted"]]


@pytest.fixture(scope="module")
def vision_tables(
    tmp_path_factory: pytest.TempPathFactory, real_frames: list[LoggedFrame]
) -> tuple[pa.Table, pa.Table]:
    types, folder = _store(Stores.ROS2_HUMBLE), tmp_path_factory.mktemp("vision")
    log = messages(families.VISION, real_frames, types)
    return ingested(ROS2_CONTAINERS["mcap_zstd"](folder / "drive", log, types), folder / "out")


@pytest.mark.parametrize("family", families.FAMILIES, ids=lambda f: f.kind.replace("/msg/", "-"))
def test_other_families(
    tmp_path: Path,
    real_frames: list[LoggedFrame],
    vision_tables: tuple[pa.Table, pa.Table],
    family: Family,
) -> None:
    """In ROS 2 and ROS 1 the same, and as vision_msgs but for what a family cannot say."""
    types, old = _store(Stores.ROS2_HUMBLE), _store(Stores.ROS1_NOETIC, vision=1)
    containers = {**ROS2_CONTAINERS, **(FOXGLOVE_CONTAINERS if family is families.SCENE else {})}
    found, poses = in_all_containers(tmp_path / "2", family, real_frames, containers, types)
    of_ros1 = in_all_containers(tmp_path / "1", family, real_frames, ROS1_CONTAINERS, old)
    assert found.equals(of_ros1[0])
    assert poses.equals(of_ros1[1])
    assert poses.equals(vision_tables[1])
    different = ["class_name", "class_name_logged"] if family.classes else []
    different += [] if family.scored == 64 else ["score"]
    different += ["yaw"] if family.course else []
    assert found.drop_columns(different).equals(vision_tables[0].drop_columns(different))
