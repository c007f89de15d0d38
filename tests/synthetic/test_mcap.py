"""The log of a simulated drive is a real one: any MCAP reader decodes the drive's own numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from hbbatch.synthetic.drive import Drive
from hbbatch.synthetic.mcap import write_mcap
from hbbatch.synthetic.settings import CLASS_NAMES


@pytest.fixture(scope="module")
def log(drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "drive.mcap"
    write_mcap(drive, path)
    return path


def messages(path: Path, topic: str) -> list[object]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [decoded for *_, decoded in reader.iter_decoded_messages(topics=[topic])]


def stamp_ns(header: object) -> int:
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def test_detections_are_those_of_the_drive(drive: Drive, log: Path) -> None:
    arrays = messages(log, "/detections")
    assert len(arrays) == len(drive.frames)
    for message, frame in zip(arrays, drive.frames, strict=True):
        assert stamp_ns(message.header) == frame.timestamp_ns
        assert message.header.frame_id == "lidar"
        for said, box, score, code in zip(
            message.detections, *list(vars(frame.detections).values())[:3], strict=True
        ):
            centre, q, size = (
                said.bbox.center.position,
                said.bbox.center.orientation,
                said.bbox.size,
            )
            assert [centre.x, centre.y, centre.z, size.x, size.y, size.z] == box[:6].tolist()
            assert 2 * np.arctan2(q.z, q.w) == pytest.approx(box[6], abs=1e-9)
            assert said.results[0].hypothesis.score == score
            assert said.results[0].hypothesis.class_id == CLASS_NAMES[code]
            assert said.id == ""


def test_transforms_chain_from_the_world_to_the_sensor(drive: Drive, log: Path) -> None:
    mounting = messages(log, "/tf_static")[0].transforms[0]
    assert (mounting.header.frame_id, mounting.child_frame_id) == ("base_link", "lidar")
    up = mounting.transform.translation.z
    for message, frame in zip(messages(log, "/tf"), drive.frames, strict=True):
        edge = message.transforms[0]
        t = edge.transform.translation
        base = np.array([t.x, t.y, t.z])
        sensor = base + up * frame.logged_pose.rotation[:, 2]
        np.testing.assert_allclose(sensor, frame.logged_pose.translation_m, atol=1e-9)
        assert (edge.header.frame_id, edge.child_frame_id) == ("odom", "base_link")


def test_odometry_says_what_tf_says(log: Path) -> None:
    for odometry, transforms in zip(messages(log, "/odom"), messages(log, "/tf"), strict=True):
        position = odometry.pose.pose.position
        translation = transforms.transforms[0].transform.translation
        assert (position.x, position.y, position.z) == (translation.x, translation.y, translation.z)


def test_the_same_drive_gives_the_same_bytes(drive: Drive, log: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    write_mcap(drive, again)
    assert again.read_bytes() == log.read_bytes()
