"""KITTI raw drives: the same content as a tracking folder, with real time stamps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hbbatch.errors import SourceError
from hbbatch.sources.base import SequenceReading, SourceOptions
from hbbatch.sources.detect import open_sources
from tests.frames import frames_of
from tests.kitti_folders import CALIBRATION, CAR, oxts_text, write_sequence

DRIVE = "2011_09_26_drive_0001_sync"


def write_drive(root: Path, frames: int = 3) -> Path:
    drive = root / "2011_09_26" / DRIVE
    (drive / "oxts" / "data").mkdir(parents=True)
    for frame, line in enumerate(oxts_text(frames).splitlines()):
        (drive / "oxts" / "data" / f"{frame:010d}.txt").write_text(f"{line}\n")
    stamps = "".join(f"2011-09-26 13:02:25.{n}94360375\n" for n in range(frames))
    (drive / "oxts" / "timestamps.txt").write_text(stamps)
    (drive / "detections").mkdir()
    rows = "".join(f"{frame} {CAR} 0.9\n" for frame in range(frames))
    (drive / "detections" / f"{DRIVE}.txt").write_text(rows)
    write_calibration(drive.parent)
    return drive


def write_calibration(day: Path) -> None:
    (day / "calib_cam_to_cam.txt").write_text(
        "calib_time: 09-Jan-2012 13:57:47\nS_rect_02: 1.242000e+03 3.750000e+02\n"
        f"R_rect_00: {CALIBRATION['R0_rect']}\nP_rect_02: {CALIBRATION['P2']}\n"
    )
    for name, key in (("velo_to_cam", "Tr_velo_to_cam"), ("imu_to_velo", "Tr_imu_to_velo")):
        rows = np.array(CALIBRATION[key].split()).reshape(3, 4)
        turn, move = " ".join(rows[:, :3].ravel()), " ".join(rows[:, 3])
        (day / f"calib_{name}.txt").write_text(f"R: {turn}\nT: {move}\n")


def read(path: Path) -> SequenceReading:
    [source] = open_sources(path, SourceOptions())
    assert source.format_name in {"kitti_raw", "kitti_tracking"}
    [handle] = source.sequences()
    [reading] = handle.read()
    return reading


def test_a_drive_gives_what_the_tracking_benchmark_gives(tmp_path: Path) -> None:
    raw = read(write_drive(tmp_path / "raw"))
    tracking = read(write_sequence(tmp_path / "tracking"))
    assert raw.sequence_id == DRIVE
    assert raw.calibration is not None
    assert tracking.calibration is not None
    assert raw.calibration.to_json() == tracking.calibration.to_json()
    for one, other in zip(frames_of(raw), frames_of(tracking), strict=True):
        np.testing.assert_array_equal(one.boxes, other.boxes)
        np.testing.assert_array_equal(one.pose.translation_m, other.pose.translation_m)
        np.testing.assert_array_equal(one.pose.rotation, other.pose.rotation)


def test_time_is_that_of_the_stamps(tmp_path: Path) -> None:
    first, second, _ = frames_of(read(write_drive(tmp_path)))
    assert first.timestamp_ns == 1_317_042_145_094_360_375
    assert second.timestamp_ns - first.timestamp_ns == 100_000_000


def test_folders_above_a_drive_are_walked(tmp_path: Path) -> None:
    write_drive(tmp_path)
    assert read(tmp_path).sequence_id == DRIVE


def test_description(tmp_path: Path) -> None:
    [source] = open_sources(write_drive(tmp_path), SourceOptions())
    description = source.describe()
    assert description.would == f"ingest it as {DRIVE}"
    assert description.messages == 3
    assert description.duration_s == pytest.approx(0.2)


def _drop_detections(drive: Path) -> None:
    (drive / "detections" / f"{DRIVE}.txt").unlink()


def _drop_oxts(drive: Path) -> None:
    (drive / "oxts" / "data" / "0000000001.txt").unlink()


def _break_stamp(drive: Path) -> None:
    (drive / "oxts" / "timestamps.txt").write_text("2011-09-26 13:02:25.1\nnoon\nnight\n")


def _break_calibration(drive: Path) -> None:
    (drive.parent / "calib_velo_to_cam.txt").write_text("R: 1 0 0\nT: 0 0 0\n")


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (_drop_detections, r"no detections \(2011_09_26_drive_0001_sync\.txt.*--detections DIR"),
        (_drop_oxts, r"oxts: 2 files in data, 3 lines in timestamps\.txt"),
        (_break_stamp, r"timestamps\.txt:2: 'noon' is no time"),
        (_break_calibration, r"calib_velo_to_cam\.txt:1: R should be 9 numbers"),
    ],
)
def test_what_is_missing_or_broken_is_named(tmp_path: Path, damage: object, expected: str) -> None:
    drive = write_drive(tmp_path)
    damage(drive)  # type: ignore[operator]
    with pytest.raises(SourceError, match=expected):
        read(drive)
