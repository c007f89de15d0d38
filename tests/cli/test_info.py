"""What the user sees of `hbbatch info`."""

from __future__ import annotations

import json
from pathlib import Path

from tests import logs
from tests.cli.test_ingest import hbbatch

SECOND = 1_000_000_000


def write_drive(path: Path) -> Path:
    log = logs.LogWriter()
    for k in range(3):
        item = logs.detection((10, 2, 0.5, 4, 2, 1.5, 0), [("car", 0.9)])
        time_ns = (k + 1) * SECOND
        log.add("/d", time_ns, logs.detections(time_ns, "lidar", [item]))
        log.add("/tf", time_ns, logs.transform(time_ns, "map", "lidar", (k, 0, 0)))
    return log.write(path)


def test_topics_frames_and_what_ingest_would_do(tmp_path: Path) -> None:
    result = hbbatch("info", write_drive(tmp_path / "drive.mcap"), cwd=tmp_path)
    assert result.returncode == 0
    for text in (
        "mcap ros2",
        "6 in 2.0 s, 2.5 Hz",
        "lidar < map",
        "ingest /d as drive",
        "vision_msgs/msg/Detection3DArray",
        "detections",
        "transforms",
    ):
        assert text in result.stdout
    assert not (tmp_path / "hbbatch_data").exists()


def test_json(tmp_path: Path) -> None:
    result = hbbatch("info", write_drive(tmp_path / "drive.mcap"), "--json", cwd=tmp_path)
    [source] = json.loads(result.stdout)["sources"]
    assert source["messages"] == source["messages_expected"] == 6
    assert (source["duration_s"], source["rate_hz"]) == (2.0, 2.5)
    [detections, transforms] = source["topics"]
    assert detections == {
        "topic": "/d",
        "message_type": "vision_msgs/msg/Detection3DArray",
        "encoding": "cdr/ros2msg",
        "messages": 3,
        "rate_hz": 1.0,
        "holds": "detections",
        "problem": "",
    }
    assert transforms["holds"] == "transforms"
    assert source["ingest_would"] == "ingest /d as drive"


def test_damage_and_missing_files_show_in_the_exit_status(tmp_path: Path) -> None:
    path = write_drive(tmp_path / "drive.mcap")
    path.write_bytes(path.read_bytes()[:-200])
    damaged = hbbatch("info", path, cwd=tmp_path)
    assert damaged.returncode == 3
    assert "ends early" in damaged.stdout
    missing = hbbatch("info", tmp_path / "nowhere", cwd=tmp_path)
    assert missing.returncode == 2
    assert missing.stderr.startswith(f"error: {tmp_path}/nowhere: does not exist.")


def test_several_topics_are_all_offered(tmp_path: Path) -> None:
    log = logs.LogWriter()
    for topic in ("/a", "/b"):
        log.add(topic, 0, logs.detections(10**9, "map", []))
    result = hbbatch("info", log.write(tmp_path / "drive.mcap"), "--json", cwd=tmp_path)
    [source] = json.loads(result.stdout)["sources"]
    assert "several detection topics (/a, /b). Use --topic." in source["ingest_would"]
    assert [topic["holds"] for topic in source["topics"]] == ["detections"] * 2


def test_what_ingest_would_do_is_found_by_reading(tmp_path: Path) -> None:
    write_drive(tmp_path / "drive.mcap")
    pauses = hbbatch("info", "drive.mcap", "--json", "--max-gap-s", 0.5, cwd=tmp_path)
    [source] = json.loads(pauses.stdout)["sources"]
    assert source["ingest_would"] == "ingest /d as drive-000, drive-001, drive-002"
    assert source["problems"] == ["topic /d: 3 sequences, it pauses between them"]
    fails = hbbatch("info", "drive.mcap", "--json", "--world-frame", "moon", cwd=tmp_path)
    [source] = json.loads(fails.stdout)["sources"]
    assert source["ingest_would"].startswith("fail: drive.mcap: topic /d: no transforms lead from")


def test_only_the_topics_asked_for_would_be_ingested(tmp_path: Path) -> None:
    log = logs.LogWriter()
    for topic in ("/a", "/b", "/c"):
        log.add(topic, 0, logs.detections(10**9, "map", []))
    log.write(tmp_path / "drive.mcap")
    chosen = hbbatch("info", "drive.mcap", "--json", "--topic", "/a", "--topic", "/c", cwd=tmp_path)
    [source] = json.loads(chosen.stdout)["sources"]
    assert source["ingest_would"] == "ingest /a as drive-a; ingest /c as drive-c"
