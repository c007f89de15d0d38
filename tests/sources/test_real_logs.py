"""Recorded files of other projects: every one is described with the right counts, or refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.records import Message
from mcap.stream_reader import StreamReader

from hbbatch.errors import SourceError
from hbbatch.sources.base import Description, SourceOptions
from hbbatch.sources.detect import open_sources

COUNTS = {
    "bad/pj_bad_schema.mcap": ("mcap", 20, 2),
    "bad/ros1_no_messages.bag": ("rosbag1", 0, 0),
    "mcap/keelson_protobuf_ais_600ch.mcap": ("mcap", 2172, 649),
    "mcap/mixed_json_protobuf_pose.mcap": ("mcap", 293, 2),
    "mcap/pj_publish_vs_log_time.mcap": ("mcap", 50, 1),
    "ros1/husky_odom_navsatfix_imu.bag": ("rosbag1", 16806, 3),
    "ros1/turtlesim_tf_bz2.bag": ("rosbag1", 8647, 9),
    "ros1/turtlesim_tf_lz4.bag": ("rosbag1", 8647, 9),
    "ros1/unsorted_chunks.bag": ("rosbag1", 3, 1),
    "ros1/webviz_cube_marker_tf.bag": ("rosbag1", 2, 2),
    "ros2/autoware_kinematic_state_db3": ("rosbag2_sqlite3", 2130, 1),
    "ros2/bagel_filezstd_db3": ("rosbag2", 6, 2),
    "ros2/bagel_filezstd_mcap": ("rosbag2", 6, 2),
    "ros2/wbag_split_db3": ("rosbag2", 6074, 8),
    "ros2/wbag_split_mcap": ("rosbag2", 6074, 8),
}
"""Format, messages and topics, as the tools of the recorders count them."""


def describe(path: Path, options: SourceOptions | None = None) -> Description:
    [source] = open_sources(path, options or SourceOptions())
    return source.describe()


@pytest.mark.parametrize("name", COUNTS)
def test_counts(test_data: Path, name: str) -> None:
    found = describe(test_data / "logs" / name)
    assert (found.format_name, found.messages, len(found.topics)) == COUNTS[name]
    assert found.findings.messages_expected in (None, found.messages)
    assert not found.findings.partial


def test_all_files_are_in_the_table_above_or_below(test_data: Path) -> None:
    logs = test_data / "logs"
    found = {
        str(source.path.relative_to(logs))
        for folder in ("bad", "mcap", "ros1", "ros2")
        for entry in (logs / folder).iterdir()
        if entry.is_dir() or entry.stat().st_size
        for source in open_sources(entry, SourceOptions())
    }
    named = {name for name in COUNTS if not name.endswith("state_db3")}
    bare = "ros2/autoware_kinematic_state_db3/bag_ego_trajectory.db3"
    assert found == {*named, bare, "bad/ros1_invalid_index.bag"}


def test_empty_bag_is_refused(test_data: Path) -> None:
    with pytest.raises(SourceError, match=r"ros1_empty_file\.bag: an empty file\. Can be read: "):
        describe(test_data / "logs/bad/ros1_empty_file.bag")


def test_bag_that_is_no_bag_behind_its_first_line(test_data: Path) -> None:
    found = describe(test_data / "logs/bad/ros1_invalid_index.bag")
    assert found.messages == 0
    assert found.findings.partial
    assert "the bag ends early" in found.findings.problems[0]
    assert "no detections in it. It holds no topics." in found.would


def test_real_frames_and_roles_are_found(test_data: Path) -> None:
    path = test_data / "logs/ros1/webviz_cube_marker_tf.bag"
    marker = describe(path)
    assert list(marker.frames) == ["child_frame < parent_frame"]
    # The boxes are in the root of the tree, which nothing says is the world.
    assert marker.would.startswith(f"fail: {path}: topic /marker_in_parent_frame: no transforms")
    assert "name the world with --world-frame" in marker.would
    told = describe(path, SourceOptions(world_frame="parent_frame"))
    assert told.would == "ingest /marker_in_parent_frame as webviz_cube_marker_tf"
    husky = describe(test_data / "logs/ros1/husky_odom_navsatfix_imu.bag")
    assert {topic.holds for topic in husky.topics} == {"poses"}
    assert {topic.problem for topic in husky.topics} == {""}


def test_conformance_files(test_data: Path) -> None:
    """All 170: the messages and channels that mcap's own reader meets, record by record."""
    paths = sorted((test_data / "logs/mcap_conformance").glob("*.mcap"))
    assert len(paths) == 170
    for path in paths:
        with path.open("rb") as file:
            expected = sum(isinstance(r, Message) for r in StreamReader(file).records)
        found = describe(path)
        assert found.messages == expected, path.name
        assert len(found.topics) == ("Message" in path.name), path.name
        assert found.findings.problems == [], path.name
        assert not found.findings.partial
