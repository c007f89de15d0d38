"""Bare ROS 2 MCAP files: topics, poses, time and damage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType

from hbbatch.errors import SourceError
from hbbatch.sources.base import SequenceReading, SourceOptions
from hbbatch.sources.detect import open_sources
from hbbatch.sources.kitti import KittiSource
from tests import logs
from tests.frames import Frame, frames_of
from tests.logs import LogWriter

SECOND = 1_000_000_000
BOX = (10.0, 2.0, 0.5, 4.0, 2.0, 1.5, 0.3)


def read(path: Path, *topics: str) -> SequenceReading:
    [source] = open_sources(path, SourceOptions(topics=topics))
    [handle] = source.sequences()
    [reading] = handle.read()
    return reading


def read_all(path: Path, *topics: str) -> tuple[list[Frame], SequenceReading]:
    reading = read(path, *topics)
    return frames_of(reading), reading


def car(score: float = 0.9, box: tuple[float, ...] = BOX) -> object:
    return logs.detection(box, [("car", score)])


def drive(frames: int = 5, topic: str = "/detections") -> LogWriter:
    """10 frames a second; the car moves 1 m a frame, its transforms come late and in between."""
    log = LogWriter()
    for k in range(frames):
        time_ns = 100 * SECOND + k * SECOND // 10
        log.add(topic, time_ns + 3, logs.detections(time_ns, "lidar", [car(0.1 * k + 0.1)]))
    for k in range(frames + 1):
        time_ns = 100 * SECOND + k * SECOND // 10 - SECOND // 20
        log.add("/tf", time_ns + 9, logs.transform(time_ns, "odom", "base_link", (k, 0, 0)))
    log.add("/tf_static", 0, logs.transform(0, "base_link", "lidar", (0.5, 0, 2)))
    return log


def test_frames_with_boxes_and_interpolated_poses(tmp_path: Path) -> None:
    frames, reading = read_all(drive().write(tmp_path / "drive.mcap"))
    assert [frame.timestamp_ns for frame in frames] == [
        100 * SECOND + k * SECOND // 10 for k in range(5)
    ]
    assert [frame.log_time_ns - frame.timestamp_ns for frame in frames if frame.log_time_ns] == [
        3
    ] * 5
    for k, frame in enumerate(frames):
        np.testing.assert_allclose(frame.boxes, [BOX], atol=1e-12)
        np.testing.assert_allclose(frame.scores, [0.1 * k + 0.1])
        assert list(frame.class_names) == ["car"]
        assert frame.frame_id == "lidar"
        assert frame.pose.origin == "interpolated"
        np.testing.assert_allclose(frame.pose.translation_m, [k + 0.5 + 0.5, 0, 2], atol=1e-9)
        assert frame.source_rows.tolist() == [k]
    assert reading.findings.problems == []
    assert not reading.findings.partial


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("index", [True, False])
def test_container_does_not_matter(
    tmp_path: Path, compression: CompressionType, index: bool
) -> None:
    parts = ("chunking", "statistics", "summary_offsets")
    options = {f"use_{part}": index for part in parts} | {"repeat_schemas": index}
    expected, _ = read_all(drive().write(tmp_path / "a.mcap"))
    path = drive().write(tmp_path / "b.mcap", compression=compression, chunk_size=300, **options)
    found, reading = read_all(path)
    assert reading.findings.problems == []
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.boxes, other.boxes)
        np.testing.assert_array_equal(one.pose.translation_m, other.pose.translation_m)


def test_best_hypothesis_names_class_and_score(tmp_path: Path) -> None:
    item = logs.detection(BOX, [("truck", 0.2), ("car", 0.7), ("bus", 0.1)])
    log = LogWriter().add("/d", SECOND, logs.detections(SECOND, "map", [item]))
    [frame], _ = read_all(log.write(tmp_path / "a.mcap"))
    assert list(frame.class_names) == ["car"]
    assert frame.scores.tolist() == [0.7]


def test_detections_without_hypotheses_count_as_one_and_that_is_said(tmp_path: Path) -> None:
    item = logs.detection(BOX, [])
    log = LogWriter().add("/d", SECOND, logs.detections(SECOND, "map", [item]))
    [frame], reading = read_all(log.write(tmp_path / "a.mcap"))
    assert frame.scores.tolist() == [1.0]
    assert list(frame.class_names) == [""]
    assert reading.findings.problems == ["topic /d: 1 boxes without score, taken as 1"]


# --- topics -------------------------------------------------------------------------------------


def two_topics(tmp_path: Path) -> Path:
    log = drive(topic="/a/detections")
    log.messages += drive(topic="/b/detections").messages[:3]
    return log.write(tmp_path / "drive.mcap")


def test_several_detection_topics_and_no_choice_lists_them(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"/a/detections, /b/detections.*--topic"):
        read(two_topics(tmp_path))


def test_topic_chooses(tmp_path: Path) -> None:
    frames, _ = read_all(two_topics(tmp_path), "/b/detections")
    assert len(frames) == 3


def test_topics_asked_for_become_sequences(tmp_path: Path) -> None:
    options = SourceOptions(topics=("/a/detections", "/b/detections"))
    [source] = open_sources(two_topics(tmp_path), options)
    assert [handle.sequence_id for handle in source.sequences()] == [
        "drive-a-detections",
        "drive-b-detections",
    ]


def test_unknown_topic_lists_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"no detections on /c.*/a/detections"):
        read(two_topics(tmp_path), "/c")


def test_log_without_detections_lists_what_it_holds(tmp_path: Path) -> None:
    log = LogWriter().add("/chat", 0, logs.message("std_msgs/msg/String", data="hello"))
    with pytest.raises(SourceError, match=r"no detections in it.*/chat \(std_msgs/msg/String\)"):
        read(log.write(tmp_path / "chat.mcap"))


# --- poses --------------------------------------------------------------------------------------


def still_log(frame_id: str = "lidar") -> LogWriter:
    return LogWriter().add("/d", SECOND, logs.detections(SECOND, frame_id, [car()]))


def test_odometry_is_joined_by_static_transforms(tmp_path: Path) -> None:
    log = still_log()
    log.add("/tf_static", 0, logs.transform(0, "base_link", "lidar", (1, 0, 0)))
    turned = logs.odometry(SECOND, "odom", "base_link", (5, 0, 0), logs.about_z(np.pi / 2))
    log.add("/odom", SECOND, turned)
    [frame], _ = read_all(log.write(tmp_path / "a.mcap"))
    np.testing.assert_allclose(frame.pose.translation_m, [5, 1, 0], atol=1e-12)
    assert frame.pose.origin == "logged"


def test_of_several_odometry_topics_the_richest_counts_and_that_is_said(tmp_path: Path) -> None:
    log = still_log("base_link")
    log.add("/gps", SECOND, logs.odometry(SECOND, "odom", "base_link", (9, 0, 0)))
    for k in range(3):
        log.add("/wheels", k, logs.odometry(k * SECOND + 1, "odom", "base_link", (k, 0, 0)))
    [frame], reading = read_all(log.write(tmp_path / "a.mcap"))
    np.testing.assert_allclose(frame.pose.translation_m, [1, 0, 0], atol=1e-6)
    assert reading.findings.problems == ["several pose topics (/gps, /wheels), /wheels counts"]


def test_without_any_pose_identity_is_recorded_and_said(tmp_path: Path) -> None:
    [frame], reading = read_all(still_log().write(tmp_path / "a.mcap"))
    assert frame.pose.origin == "identity"
    [problem] = reading.findings.problems
    assert "no ego poses" in problem


def test_detections_in_a_world_frame_need_no_pose(tmp_path: Path) -> None:
    [frame], reading = read_all(still_log("/map").write(tmp_path / "a.mcap"))
    assert (frame.pose.origin, frame.frame_id) == ("logged", "map")
    assert reading.findings.problems == []


def test_missing_link_names_the_known_frames(tmp_path: Path) -> None:
    log = still_log().add("/tf", SECOND, logs.transform(SECOND, "odom", "base_link", (0, 0, 0)))
    with pytest.raises(SourceError, match=r"a\.mcap: topic /d: .*'lidar'.*base_link, odom"):
        read(log.write(tmp_path / "a.mcap"))


def test_frames_too_far_from_any_pose_are_left_out_and_counted(tmp_path: Path) -> None:
    log = drive(3)
    late = 200 * SECOND
    log.add("/detections", late, logs.detections(late, "lidar", [car()]))
    frames, reading = read_all(log.write(tmp_path / "a.mcap"))
    assert len(frames) == 3
    assert reading.findings.partial
    assert reading.findings.problems == ["1 frames left out: no pose of the sensor within 0.1 s"]


def test_poses_of_another_time_are_an_error(tmp_path: Path) -> None:
    log = still_log()
    for k in (100, 101):
        log.add("/tf", k, logs.transform(k * SECOND, "map", "lidar", (0, 0, 0)))
    with pytest.raises(SourceError, match="cover different times"):
        read(log.write(tmp_path / "a.mcap"))


# --- time ---------------------------------------------------------------------------------------


def test_frames_are_in_order_of_their_stamps(tmp_path: Path) -> None:
    log = LogWriter()
    for k, time_ns in enumerate([3, 1, 2, 1]):
        log.add("/d", k, logs.detections(time_ns * SECOND, "map", [car(score=k / 10)]))
    frames, reading = read_all(log.write(tmp_path / "a.mcap"))
    assert [frame.timestamp_ns // SECOND for frame in frames] == [1, 1, 2, 3]
    assert [frame.source_rows.tolist() for frame in frames] == [[1], [3], [2], [0]]
    assert reading.findings.problems == ["topic /d: stamps run backwards 2 times, sorted"]


def test_zero_stamps_fall_back_to_the_log_time(tmp_path: Path) -> None:
    log = LogWriter().add("/d", 7 * SECOND, logs.detections(0, "map", [car()]))
    [frame], reading = read_all(log.write(tmp_path / "a.mcap"))
    assert frame.timestamp_ns == 7 * SECOND
    assert reading.findings.problems == ["topic /d: 1 messages without stamp, log time taken"]


def test_log_time_of_a_broken_clock_fits_the_tables(tmp_path: Path) -> None:
    log = LogWriter().add("/d", 2**64 - 1, logs.detections(SECOND, "map", [car()]))
    [frame], _ = read_all(log.write(tmp_path / "a.mcap"))
    assert frame.log_time_ns == 2**63 - 1


# --- damage -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "box",
    [
        (float("nan"), *BOX[1:]),
        (*BOX[:3], -4.0, *BOX[4:]),
        (*BOX[:3], 0.0, *BOX[4:]),
        (1e300, *BOX[1:]),
    ],
)
def test_boxes_that_are_none_are_left_out_and_counted(
    tmp_path: Path, box: tuple[float, ...]
) -> None:
    log = LogWriter()
    for k in range(3):
        items = [car(), car(box=box)] if k else [car()]
        log.add("/d", k, logs.detections((k + 1) * SECOND, "map", items))
    frames, reading = read_all(log.write(tmp_path / "a.mcap"))
    assert [len(frame.boxes) for frame in frames] == [1, 1, 1]
    assert reading.findings.partial
    assert "2 boxes left out, first in message 1" in reading.findings.problems[0]


def test_truncated_file_gives_what_is_whole(tmp_path: Path) -> None:
    path = drive(40).write(tmp_path / "a.mcap", chunk_size=500, compression=CompressionType.NONE)
    path.write_bytes(path.read_bytes()[:15_000])
    [source] = open_sources(path, SourceOptions(topics=("/detections",)))
    [handle] = source.sequences()
    [reading] = handle.read()
    frames = frames_of(reading)
    assert 0 < len(frames) < 40
    assert reading.findings.partial
    ends, counts, *_ = reading.findings.problems
    assert ends.startswith("the file ends early, at byte 15000")
    # The count that a file declares lies at its end.
    read_count = reading.findings.messages_read
    assert counts == f"{read_count} messages were read; how many there were is not known"
    assert read_count >= len(frames)


def test_error_of_a_truncated_file_names_the_damage(tmp_path: Path) -> None:
    path = drive(40).write(tmp_path / "a.mcap", chunk_size=500)
    path.write_bytes(path.read_bytes()[:12_000])
    with pytest.raises(SourceError, match=r"'lidar' .*Damage: the file ends early, at byte 12000"):
        read(path)


def test_flipped_bit_is_noticed(tmp_path: Path) -> None:
    log = drive(40)
    log.messages.sort(key=lambda entry: entry[1])
    path = log.write(tmp_path / "a.mcap", chunk_size=2000)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 16
    path.write_bytes(content)
    frames, reading = read_all(path)
    assert 0 < len(frames) < 40
    assert reading.findings.partial


def test_bad_definition_of_another_topic_costs_nothing(tmp_path: Path) -> None:
    log = drive().add("/chat", 0, logs.message("std_msgs/msg/String", data="hello"))
    path = log.write(tmp_path / "a.mcap", schema_text={"std_msgs/msg/String": "%&/ garbage"})
    frames, reading = read_all(path)
    assert len(frames) == 5
    assert reading.findings.problems == []


def test_bad_definition_of_the_detections_is_an_error(tmp_path: Path) -> None:
    text = {"vision_msgs/msg/Detection3DArray": "%&/ garbage"}
    with pytest.raises(SourceError, match=r"/detections: the embedded definition .*cannot be used"):
        read(drive().write(tmp_path / "a.mcap", schema_text=text))


def test_empty_file_with_magic_only(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(SourceError, match=r"no detections in it\. It holds no topics"):
        read(path)


# --- the same content in another container ------------------------------------------------------


def test_real_detections_come_out_of_a_log_as_they_come_out_of_kitti(
    tmp_path: Path, test_data: Path
) -> None:
    found = test_data / "kitti/detections/virconv/training"
    handle = KittiSource(test_data / "kitti/training", SourceOptions(found)).sequences()[0]
    expected = frames_of(handle.read()[0])[:20]
    log = LogWriter()
    for frame in expected:
        time_ns = frame.timestamp_ns + SECOND
        named = zip(frame.boxes, frame.class_names, frame.scores, strict=True)
        items = [logs.detection(box, [(name, float(score))]) for box, name, score in named]
        log.add("/d", time_ns, logs.detections(time_ns, "camera", items))
        pose = frame.pose
        log.add(
            "/tf",
            time_ns,
            logs.transform(time_ns, "map", "camera", pose.translation_m, pose.rotation),
        )
    frames, _ = read_all(log.write(tmp_path / "a.mcap"))
    for one, other in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(one.boxes[:, :6], other.boxes[:, :6])
        np.testing.assert_allclose(one.boxes[:, 6], other.boxes[:, 6], atol=1e-15 * 8)
        np.testing.assert_array_equal(one.scores, other.scores)
        np.testing.assert_allclose(one.pose.translation_m, other.pose.translation_m, atol=1e-12)
        np.testing.assert_allclose(one.pose.rotation, other.pose.rotation, atol=1e-15 * 4)
        assert one.pose.origin == "logged"


def test_real_logs_without_detections_say_what_they_hold(test_data: Path) -> None:
    paths = sorted((test_data / "logs").rglob("*.mcap"))
    assert len(paths) > 170
    for path in paths:
        [source] = open_sources(path, SourceOptions())
        with pytest.raises(SourceError, match=r"no detections in it\. It holds .+"):
            source.sequences()
