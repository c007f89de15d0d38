"""A drive is reproducible, and its parts fit together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hbbatch.boxes import YAW, transform_boxes, wrap_angle
from hbbatch.synthetic.drive import Drive, simulate_drive
from hbbatch.synthetic.labels import labels_table, occlusion_levels
from hbbatch.synthetic.settings import (
    CLASS_NAMES,
    DetectorSettings,
    DriveSettings,
    SensorSettings,
    TrafficSettings,
)

SHORT = DriveSettings(duration_s=3.0)


def test_the_seed_decides_the_drive() -> None:
    first, again, other = (simulate_drive(SHORT, seed) for seed in (1, 1, 2))
    for a, b in zip(first.frames, again.frames, strict=True):
        assert (a.object_boxes == b.object_boxes).all()
        assert (a.detections.boxes == b.detections.boxes).all()
        assert (a.logged_pose.translation_m == b.logged_pose.translation_m).all()
    assert (
        first.frames[0].object_boxes.shape != other.frames[0].object_boxes.shape
        or not (first.frames[0].object_boxes == other.frames[0].object_boxes).all()
    )


def test_another_detector_does_not_change_the_traffic() -> None:
    worse = replace(SHORT, detector=DetectorSettings(max_recall=0.5, position_noise_m=0.4))
    usual, noisy = simulate_drive(SHORT, 1), simulate_drive(worse, 1)
    assert (usual.frames[-1].object_boxes == noisy.frames[-1].object_boxes).all()
    found = [sum((f.detections.object_id >= 0).sum() for f in d.frames) for d in (usual, noisy)]
    assert found[1] < 0.7 * found[0]


def test_detections_lie_where_the_truth_is(drive: Drive) -> None:
    offset, turn = [], []
    for frame in drive.frames:
        real = frame.detections.object_id >= 0
        world = transform_boxes(
            frame.detections.boxes[real], frame.pose.rotation, frame.pose.translation_m
        )
        error = world - frame.object_boxes[frame.detections.object_id[real]]
        offset.append(np.linalg.norm(error[:, :3], axis=1))
        turn.append(np.abs(wrap_angle(error[:, YAW])))
    assert len(np.concatenate(offset)) > 500
    assert np.median(np.concatenate(offset)) < 0.25
    assert np.median(np.concatenate(turn)) < 0.1


def test_time_and_ego_motion_run_evenly(drive: Drive) -> None:
    stamps = np.array([frame.timestamp_ns for frame in drive.frames])
    assert (np.diff(stamps) == 100_000_000).all()
    place = np.array([frame.pose.translation_m for frame in drive.frames])
    speed = np.linalg.norm(np.diff(place, axis=0), axis=1) / 0.1
    told = np.array([frame.speed_m_s for frame in drive.frames])[1:]
    assert told.max() > 2.0
    np.testing.assert_allclose(speed, told, atol=0.6)


def test_logged_poses_are_a_little_off(drive: Drive) -> None:
    error = [f.logged_pose.translation_m - f.pose.translation_m for f in drive.frames]
    assert np.std(error) == pytest.approx(drive.settings.sensor.pose_noise_m, rel=0.15)


def test_settings_make_other_drives() -> None:
    empty = TrafficSettings(moving_vehicles=0, parked_vehicles=0, cyclists=0, pedestrians=0)
    silent = DetectorSettings(transient_per_frame=0.0, clutter=0)
    alone = simulate_drive(replace(SHORT, traffic=empty, detector=silent), 0)
    assert len(alone.class_codes) == 0
    assert all(len(frame.detections.scores) == 0 for frame in alone.frames)

    ahead = replace(SHORT, sensor=SensorSettings(field_of_view_rad=1.5), rate_hz=5.0)
    camera = simulate_drive(ahead, 0)
    assert len(camera.frames) == 15
    boxes = np.concatenate([frame.detections.boxes for frame in camera.frames])
    assert (np.abs(np.arctan2(boxes[:, 1], boxes[:, 0])) < 0.85).all()


def test_labels_hold_the_truth_in_the_sensor_frame(drive: Drive) -> None:
    labels = labels_table(drive, "lidar")
    frame = drive.frames[40]
    rows = labels.filter(np.equal(labels["frame_index"].to_numpy(), 40)).to_pylist()
    assert {row["timestamp_ns"] for row in rows} == {frame.timestamp_ns}
    assert len(rows) > 10
    for row in rows:
        seen = frame.seen.boxes[row["object_id"]]
        assert [row["x"], row["y"], row["yaw"]] == seen[[0, 1, 6]].tolist()
        assert row["class_name"] == CLASS_NAMES[drive.class_codes[row["object_id"]]]
        assert np.hypot(row["x"], row["y"]) <= drive.settings.sensor.range_m + 10.0


def test_what_the_sensor_could_not_see_is_marked_hidden(drive: Drive) -> None:
    for frame in drive.frames[::20]:
        levels = occlusion_levels(frame.seen)
        unseen = (frame.seen.visible < 0.15) | (frame.seen.points < 10.0)
        assert ((levels == 3) == unseen).all()
        assert (frame.seen.visible[levels == 0] >= 0.8).all()
