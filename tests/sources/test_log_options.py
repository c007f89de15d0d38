"""What a user may say about a log: mappings, poses, pauses; and the poses that are found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg

from hbbatch.errors import ConfigError, SourceError
from hbbatch.sources import gaps
from hbbatch.sources.base import SequenceReading, SourceOptions
from hbbatch.sources.classes import load_taxonomy
from hbbatch.sources.detect import open_sources
from hbbatch.sources.messages.satellite import east_north_up
from tests import log_families as families
from tests import logs
from tests.frames import frames_of
from tests.log_containers import Logged, mcap

SECOND = 1_000_000_000
TYPES = families.store(Stores.ROS2_HUMBLE)
POINT = {"x": 5.0, "y": 1.0, "z": 0.0}
TURN = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def readings(path: Path, **options: Any) -> list[SequenceReading]:
    [source] = open_sources(path, SourceOptions(**options))
    [handle] = source.sequences()
    return list(handle.read())


def still(kind: str, content: dict[str, Any], path: Path, *more: Logged) -> Path:
    """A detection in the frame `lidar`, which hangs 1 m ahead of `base`, and another message."""
    found = logs.detections(SECOND, "lidar", [logs.detection((1, 0, 0, 4, 2, 1, 0), [("car", 1)])])
    static = logs.transform(0, "base", "lidar", (1, 0, 0))
    log = [
        Logged("/found", found.__msgtype__, SECOND, found),
        Logged("/tf_static", static.__msgtype__, SECOND, static),
        Logged("/other", kind, SECOND, families.make(TYPES, kind, content)),
    ]
    return mcap()(path, [*log, *more], TYPES)


def header(frame: str) -> dict[str, Any]:
    return {"stamp": families.stamp(SECOND), "frame_id": frame}


POSE = {"position": POINT, "orientation": TURN}
POSE_MESSAGES = {
    "geometry_msgs/msg/PoseStamped": {"header": header("map"), "pose": POSE},
    "geometry_msgs/msg/PoseWithCovarianceStamped": {
        "header": header("map"),
        "pose": {"pose": POSE},
    },
}


@pytest.mark.parametrize("kind", POSE_MESSAGES)
def test_a_pose_of_nothing_named_is_that_of_the_vehicle(tmp_path: Path, kind: str) -> None:
    [reading] = readings(still(kind, POSE_MESSAGES[kind], tmp_path / "a"))
    [frame] = frames_of(reading)
    np.testing.assert_allclose(frame.pose.translation_m, [6, 1, 0])
    assert frame.pose.origin == "logged"
    expected = "/other says not what it is the pose of: taken as 'base'"
    assert reading.findings.problems == [expected]


def test_satellite_fixes_with_imu_orientation(tmp_path: Path) -> None:
    fix = {"header": header("base"), "latitude": 49.0, "longitude": 8.4, "altitude": 110.0}
    imu = {"header": header("base"), "orientation": {"x": 0, "y": 0, "z": 1.0, "w": 0.0}}
    kind = "sensor_msgs/msg/Imu"
    more = Logged("/imu", kind, SECOND, families.make(TYPES, kind, imu))
    [reading] = readings(still("sensor_msgs/msg/NavSatFix", fix, tmp_path / "a", more))
    [frame] = frames_of(reading)
    np.testing.assert_allclose(frame.pose.translation_m, [-1, 0, 0], atol=1e-9)
    assert "satellite fixes" in reading.findings.problems[0]


def test_east_north_up_of_a_hundredth_of_a_degree() -> None:
    """One degree of latitude at 49 degrees north is 111.2 km, of longitude 73.2 km."""
    metres = east_north_up(np.array([[49.0, 8.0, 0.0], [49.01, 8.0, 0.0], [49.0, 8.01, 5.0]]))
    np.testing.assert_allclose(metres[1, :2], [0, 1112.0], atol=1.0)
    np.testing.assert_allclose(metres[2], [731.7, 0, 5], atol=1.0)


def two_worlds(path: Path) -> Path:
    log = logs.LogWriter()
    log.add(
        "/found",
        SECOND,
        logs.detections(SECOND, "base", [logs.detection((1, 0, 0, 4, 2, 1, 0), [("car", 1)])]),
    )
    log.add("/tf", SECOND, logs.transform(SECOND, "odom", "base", (2, 0, 0)))
    log.add("/tf", SECOND, logs.transform(SECOND, "map", "odom", (10, 0, 0)))
    log.add("/odom", SECOND, logs.odometry(SECOND, "wheel_odom", "base", (7, 0, 0)))
    return log.write(path)


@pytest.mark.parametrize(
    ("options", "x"),
    [({}, 12), ({"world_frame": "/odom"}, 2), ({"pose_topic": "/odom"}, 7)],
)
def test_world_frame_and_pose_topic(tmp_path: Path, options: dict[str, str], x: float) -> None:
    [reading] = readings(two_worlds(tmp_path / "a.mcap"), **options)
    assert frames_of(reading)[0].pose.translation_m[0] == x


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"world_frame": "moon"}, r"'base' to 'moon' \(--world-frame\)\. Frames known: base, map"),
        ({"pose_topic": "/gps"}, r"no poses on topic /gps \(--pose-topic\)\. Pose topics: /odom"),
    ],
)
def test_a_choice_that_does_not_reach_is_an_error(
    tmp_path: Path, options: dict[str, str], expected: str
) -> None:
    with pytest.raises(SourceError, match=expected):
        readings(two_worlds(tmp_path / "a.mcap"), **options)


# --- pauses -------------------------------------------------------------------------------------


def paused(path: Path) -> Path:
    log = logs.LogWriter()
    for seconds in (1.0, 1.1, 1.2, 60.0, 60.1, 90.0):
        time_ns = int(seconds * SECOND)
        log.add("/found", time_ns, logs.detections(time_ns, "map", []))
    return log.write(path)


def test_pauses_start_new_sequences(tmp_path: Path) -> None:
    parts = readings(paused(tmp_path / "drive.mcap"))
    assert [part.sequence_id for part in parts] == ["drive-000", "drive-001", "drive-002"]
    assert [len(frames_of(part)) for part in parts] == [3, 2, 1]
    assert all("3 sequences" in part.findings.problems[-1] for part in parts)


def test_the_longest_pause_can_be_chosen(tmp_path: Path) -> None:
    path = paused(tmp_path / "drive.mcap")
    assert [r.sequence_id for r in readings(path, max_gap_s=40.0)] == ["drive-000", "drive-001"]
    assert [r.sequence_id for r in readings(path, max_gap_s=100.0)] == ["drive"]


def test_a_low_rate_is_no_pause() -> None:
    stamps_ns = np.arange(10) * 5 * SECOND
    assert gaps.parts(stamps_ns, None) == [slice(0, 10)]


# --- types of one's own -------------------------------------------------------------------------

OWN = {
    "my_msgs/msg/Objects": "builtin_interfaces/Time at\nstring where\nmy_msgs/Thing[] items\n",
    "my_msgs/msg/Thing": "geometry_msgs/Point middle\nfloat32[3] unused\nfloat64 long\n"
    "float64 wide\nfloat64 high\nfloat64 course\nfloat32 sure\nuint8 label\nstring[] names\n",
}
MAPPING = """
messages:
  - type: my_msgs/Objects
    objects: items
    time: at
    frame: where
    centre: middle
    size: [long, wide, high]
    yaw: course
    score: sure
    class: label
    classes: {1: car, 2: pedestrian}
"""


def own_log(path: Path) -> Path:
    types = families.store(Stores.ROS2_HUMBLE)
    for name, text in OWN.items():
        types.register({n: f for n, f in get_types_from_msg(text, name).items() if n == name})
    things = [
        {"middle": POINT, "long": 4.0, "wide": 2.0, "high": 1.5, "course": 0.5, "sure": 0.5}
        | {"label": label, "names": [f"kind {label}"][: label % 2]}
        for label in (1, 2, 9)
    ]
    content = {"at": families.stamp(SECOND), "where": "map", "items": things}
    message = families.make(types, "my_msgs/msg/Objects", content)
    return mcap()(path, [Logged("/things", "my_msgs/msg/Objects", 1, message)], types)


def test_mapping_file(tmp_path: Path) -> None:
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text(MAPPING)
    [reading] = readings(own_log(tmp_path / "a"), mappings=(mapping,))
    [frame] = frames_of(reading)
    assert frame.timestamp_ns == SECOND
    np.testing.assert_array_equal(frame.boxes, [[5, 1, 0, 4, 2, 1.5, 0.5]] * 3)
    assert frame.class_names == ["car", "pedestrian", "9"]
    assert frame.scores.tolist() == [0.5] * 3


def test_a_mapping_counts_for_a_type_that_is_known_too(tmp_path: Path) -> None:
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text(
        "messages:\n  - type: vision_msgs/Detection3DArray\n    objects: detections\n"
        "    centre: bbox.size\n    size: bbox.size\n    orientation: bbox.center.orientation\n"
    )
    [reading] = readings(two_worlds(tmp_path / "a.mcap"), mappings=(mapping,))
    np.testing.assert_array_equal(frames_of(reading)[0].boxes, [[4, 2, 1, 4, 2, 1, 0]])


def test_without_its_mapping_the_type_is_listed(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"no detections in it.*my_msgs/msg/Objects"):
        readings(own_log(tmp_path / "a"))


def test_elements_of_lists_are_numbered(tmp_path: Path) -> None:
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text(MAPPING.replace("class: label", "class: names.0"))
    [reading] = readings(own_log(tmp_path / "a"), mappings=(mapping,))
    [frame] = frames_of(reading)
    assert frame.class_names == ["kind 1", "", "kind 9"]


def test_a_field_that_is_not_there_is_named(tmp_path: Path) -> None:
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text(MAPPING.replace("score: sure", "score: certainty.high"))
    with pytest.raises(SourceError, match=r"1 messages left out.*no field certainty\.high, which"):
        readings(own_log(tmp_path / "a"), mappings=(mapping,))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("yaw: course", "yaww: course"), "yaww.*score, class, classes"),
        (("    yaw: course\n", ""), "orientation or yaw"),
    ],
)
def test_mapping_that_is_wrong(tmp_path: Path, change: tuple[str, str], expected: str) -> None:
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text(MAPPING.replace(*change))
    with pytest.raises(ConfigError, match=rf"mapping\.yaml: .*{expected}"):
        readings(own_log(tmp_path / "a"), mappings=(mapping,))


def test_classes_of_a_file_win_over_the_table(tmp_path: Path) -> None:
    path = tmp_path / "classes.yaml"
    path.write_text("classes:\n  car: [Voiture, sedan_xl]\n  forklift: []\n  bus: [coach, train]\n")
    taxonomy = load_taxonomy(path)
    names = ("voiture", "Sedan XL", "Forklift", "train", "lorry", "ufo")
    assert [taxonomy.normalise(name) for name in names] == [
        "car",
        "car",
        "forklift",
        "bus",
        "truck",
        "unknown",
    ]


def test_mixed_clocks_are_counted(tmp_path: Path) -> None:
    log = logs.LogWriter()
    for k in range(10):
        stamp_ns = k * SECOND + (10**18 if k < 3 else 0) + SECOND
        log.add("/found", (k + 1) * SECOND, logs.detections(stamp_ns, "map", []))
    [*_, reading] = readings(log.write(tmp_path / "a.mcap"))
    text = " ".join(reading.findings.problems)
    assert "mixed clocks: 3 of 10 messages" in text
