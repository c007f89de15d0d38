"""What decoded messages mean: shapes that are no boxes, lists, headings, classes, poses."""

from __future__ import annotations

from math import cos, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores

from hbbatch.sources.base import SourceOptions
from hbbatch.sources.detect import open_sources
from hbbatch.sources.messages import DETECTION_MESSAGES, DetectionMessage
from tests import log_families as families
from tests.frames import frames_of
from tests.log_containers import Logged, mcap

SECOND = 1_000_000_000
TYPES = families.store(Stores.ROS2_HUMBLE)
HEADER = {"stamp": {"sec": 1, "nanosec": 5}, "frame_id": "lidar"}
SIZE = {"x": 4.0, "y": 2.0, "z": 1.5}
QUARTER = {"z": sin(pi / 4), "w": cos(pi / 4)}
"""A quarter turn about z."""


def read(kind: str, content: dict[str, Any]) -> DetectionMessage:
    return DETECTION_MESSAGES[kind](families.make(TYPES, kind, content))


def place(x: float, y: float, z: float, turn: dict[str, float] | None = None) -> dict[str, Any]:
    return {"position": {"x": x, "y": y, "z": z}, "orientation": turn or {"w": 1.0}}


# --- Autoware -----------------------------------------------------------------------------------

DETECTED = "autoware_perception_msgs/msg/DetectedObjects"
BOX, CYLINDER, POLYGON = 0, 1, 2
FOOTPRINT = {"points": [{"x": -1.0, "y": 0.0}, {"x": 3.0, "y": 1.0}, {"x": 1.0, "y": -2.0}]}


def autoware_object(shape: dict[str, Any], turn: dict[str, float] = QUARTER) -> dict[str, Any]:
    return {
        "existence_probability": 0.5,
        "kinematics": {
            "pose_with_covariance": {"pose": place(10, 20, 1, turn)},
            "orientation_availability": 2,
        },
        "shape": shape,
    }


def autoware(*shapes: dict[str, Any]) -> dict[str, Any]:
    return {"header": HEADER, "objects": [autoware_object(shape) for shape in shapes]}


def test_autoware_cylinder_is_as_wide_as_long() -> None:
    diameter = {"x": 0.8, "y": 0.8, "z": 1.7}
    found = read(DETECTED, autoware({"type": CYLINDER, "dimensions": diameter}))
    np.testing.assert_allclose(found.boxes, [[10, 20, 1, 0.8, 0.8, 1.7, pi / 2]])


def test_autoware_polygon_is_the_rectangle_about_its_footprint() -> None:
    """4 m along and 3 m across the pose, whose x points along the frame's y: centre (1, -0.5)."""
    shape = {"type": POLYGON, "footprint": FOOTPRINT, "dimensions": {"z": 2.5}}
    found = read(DETECTED, autoware(shape))
    np.testing.assert_allclose(found.boxes, [[10.5, 21, 1, 4, 3, 2.5, pi / 2]])


def test_autoware_polygon_of_no_orientation_lies_in_the_axes_of_the_frame() -> None:
    shape = {"type": POLYGON, "footprint": FOOTPRINT, "dimensions": {"z": 2.5}}
    nothing = autoware_object(shape, {"w": 0.0})
    found = read(DETECTED, {"header": HEADER, "objects": [nothing]})
    np.testing.assert_allclose(found.boxes, [[11, 19.5, 1, 4, 3, 2.5, 0]])


def test_autoware_polygon_without_footprint_has_its_dimensions() -> None:
    found = read(DETECTED, autoware({"type": POLYGON, "dimensions": SIZE}))
    np.testing.assert_allclose(found.boxes, [[10, 20, 1, 4, 2, 1.5, pi / 2]])


def test_autoware_shapes_of_a_log(tmp_path: Path) -> None:
    """Boxes are walked together, polygons read one by one: a log with both gives both."""
    box, polygon = {"dimensions": SIZE}, {"type": POLYGON, "footprint": FOOTPRINT}
    polygon["dimensions"] = {"z": 2.5}
    contents = [autoware(box), autoware(box, polygon)]
    path = mcap()(
        tmp_path / "a",
        [
            Logged("/o", DETECTED, k, families.make(TYPES, DETECTED, c))
            for k, c in enumerate(contents)
        ],
        TYPES,
    )
    first, second = one_sequence(path)
    np.testing.assert_allclose(first.boxes, [[10, 20, 1, 4, 2, 1.5, pi / 2]])
    np.testing.assert_array_equal(second.boxes[0], first.boxes[0])
    np.testing.assert_allclose(second.boxes[1], [10.5, 21, 1, 4, 3, 2.5, pi / 2])


@pytest.mark.parametrize(("availability", "unsure"), [(0, 1), (1, 1), (2, 0)])
def test_autoware_yaw_of_unknown_sign_is_kept_and_counted(availability: int, unsure: int) -> None:
    content = autoware({"dimensions": SIZE})
    content["objects"][0]["kinematics"]["orientation_availability"] = availability
    found = read(DETECTED, content)
    assert found.unsure_yaws == unsure
    assert found.boxes[0, 6] == pytest.approx(pi / 2)


@pytest.mark.parametrize(
    ("labels", "expected"),
    [((), "unknown"), ((1, 7), "pedestrian"), ((1, 9), "hazard"), ((1, 77), "77")],
)
def test_autoware_class_is_the_label_of_highest_probability(
    labels: tuple[int, ...], expected: str
) -> None:
    content = autoware({"dimensions": SIZE})
    content["objects"][0]["classification"] = [
        {"label": label, "probability": 0.25 * (n + 1)} for n, label in enumerate(labels)
    ]
    assert read(DETECTED, content).class_names == [expected]


# --- markers ------------------------------------------------------------------------------------

MARKER = "visualization_msgs/msg/Marker"
CUBE, SPHERE, CUBE_LIST = 1, 2, 6
DELETE = 2


def marker(**fields: Any) -> dict[str, Any]:
    shown = {"header": HEADER, "ns": "car", "pose": place(10, 20, 1, QUARTER), "scale": SIZE}
    return {**shown, "type": CUBE, **fields}


def test_single_marker() -> None:
    found = read(MARKER, marker())
    assert (found.stamp_ns, found.frame_id, found.class_names) == (SECOND + 5, "lidar", ["car"])
    np.testing.assert_allclose(found.boxes, [[10, 20, 1, 4, 2, 1.5, pi / 2]])
    assert np.isnan(found.scores).all()


@pytest.mark.parametrize("length", [1.0, 3.0])
def test_points_of_a_cube_list_lie_in_the_axes_of_its_pose(length: float) -> None:
    """Whatever the length of the quaternion."""
    turn = {axis: length * value for axis, value in QUARTER.items()}
    points = [{"x": 2.0, "y": 0.0, "z": 0.5}, {"x": 0.0, "y": 3.0}]
    found = read(MARKER, marker(type=CUBE_LIST, points=points, pose=place(10, 20, 1, turn)))
    expected = [[10, 22, 1.5, 4, 2, 1.5, pi / 2], [7, 20, 1, 4, 2, 1.5, pi / 2]]
    np.testing.assert_allclose(found.boxes, expected)


def test_cube_list_of_no_orientation() -> None:
    shown = marker(type=CUBE_LIST, points=[{"x": 2.0}], pose=place(1, 1, 1, {"w": 0.0}))
    np.testing.assert_allclose(read(MARKER, shown).boxes, [[3, 1, 1, 4, 2, 1.5, 0]])


def test_markers_that_show_no_box() -> None:
    content = {"markers": [marker(type=SPHERE), marker(action=DELETE), marker(ns="", text="bus")]}
    found = read("visualization_msgs/msg/MarkerArray", content)
    assert found.class_names == ["bus"]
    assert read(MARKER, marker(type=SPHERE)).boxes.shape == (0, 7)


def test_cubes_of_another_frame_are_counted() -> None:
    other = marker(header={**HEADER, "frame_id": "radar"})
    found = read("visualization_msgs/msg/MarkerArray", {"markers": [marker(), other]})
    assert (len(found.boxes), found.foreign) == (1, 1)


# --- other object lists -------------------------------------------------------------------------


def radar_track(vx: float, vy: float, classification: int) -> dict[str, Any]:
    return {
        "position": {"x": 10.0, "y": 20.0, "z": 1.0},
        "velocity": {"x": vx, "y": vy},
        "size": SIZE,
        "classification": classification,
    }


def test_radar_tracks_head_where_they_move() -> None:
    tracks = [radar_track(0, 5, 32001), radar_track(0.1, 0.1, 1), radar_track(-3, 0, 32007)]
    found = read("radar_msgs/msg/RadarTracks", {"header": HEADER, "tracks": tracks})
    np.testing.assert_array_equal(found.boxes[:, 6], [pi / 2, 0, pi])
    np.testing.assert_array_equal(found.boxes[:, :6], [[10, 20, 1, 4, 2, 1.5]] * 3)
    assert found.class_names == ["car", "unknown", "pedestrian"]
    assert found.unsure_yaws == 1
    assert np.isnan(found.scores).all()


def test_derived_object_that_is_no_box_has_no_size() -> None:
    """Sizes of zero are left out and counted further on."""
    sphere = {"pose": place(1, 2, 3), "shape": {"type": 2, "dimensions": [5.0]}}
    box = {"pose": place(1, 2, 3), "shape": {"type": 1, "dimensions": [4.0, 2.0, 1.5]}}
    box |= {"classification": 6, "classification_certainty": 51}
    found = read(
        "derived_object_msgs/msg/ObjectArray", {"header": HEADER, "objects": [sphere, box]}
    )
    np.testing.assert_array_equal(found.boxes[:, 3:6], [[0, 0, 0], [4, 2, 1.5]])
    assert found.scores.tolist() == [0, 0.2]
    assert found.class_names == ["unknown", "car"]


def test_scene_entities_say_class_and_score_in_their_metadata() -> None:
    cube = {"pose": place(1, 2, 3), "size": SIZE}
    named = [{"key": "Type", "value": "bus"}, {"key": "confidence", "value": "0.25"}]
    garbled = [{"key": "label", "value": "van"}, {"key": "score", "value": "high"}]
    entities = [
        {"frame_id": "lidar", "metadata": metadata, "cubes": [cube]}
        for metadata in (named, garbled)
    ]
    found = read("foxglove_msgs/msg/SceneUpdate", {"entities": [*entities, {"frame_id": "lidar"}]})
    assert found.class_names == ["bus", "van"]
    np.testing.assert_array_equal(found.scores, [0.25, np.nan])


# --- poses --------------------------------------------------------------------------------------

STAMP = {"sec": 1, "nanosec": 0}
EDGE = {
    "timestamp": STAMP,
    "parent_frame_id": "map",
    "child_frame_id": "lidar",
    "translation": {"x": 5.0, "y": 6.0, "z": 7.0},
    "rotation": QUARTER,
}
FOXGLOVE_POSES = {
    "FrameTransform": EDGE,
    "FrameTransforms": {"transforms": [EDGE]},
    "PoseInFrame": {"timestamp": STAMP, "frame_id": "map", "pose": place(5, 6, 7, QUARTER)},
}


@pytest.mark.parametrize("name", FOXGLOVE_POSES)
def test_poses_of_foxglove(tmp_path: Path, name: str) -> None:
    shown = families.make(TYPES, MARKER, {**marker(), "header": {**HEADER, "stamp": STAMP}})
    kind = f"foxglove_msgs/msg/{name}"
    said = families.make(TYPES, kind, FOXGLOVE_POSES[name])
    log = [Logged("/shown", MARKER, SECOND, shown), Logged("/pose", kind, SECOND, said)]
    [frame] = one_sequence(mcap()(tmp_path / "a", log, TYPES))
    np.testing.assert_array_equal(frame.pose.translation_m, [5, 6, 7])
    np.testing.assert_allclose(frame.pose.rotation, [0, 0, sin(pi / 4), cos(pi / 4)])
    assert frame.pose.origin == "logged"


def one_sequence(path: Path) -> list[Any]:
    [source] = open_sources(path, SourceOptions())
    [handle] = source.sequences()
    [reading] = handle.read()
    return frames_of(reading)
