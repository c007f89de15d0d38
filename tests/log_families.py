"""The same frames as messages of every family that holds detections."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from hbbatch.boxes import FloatArray
from hbbatch.sources.messages.definitions import KNOWN_DEFINITIONS

FRAME_ID = "camera"
WORLD = "map"


@dataclass(frozen=True)
class LoggedFrame:
    """What a frame of a log says, with class names that every family can say."""

    time_ns: int
    boxes: FloatArray
    scores: FloatArray
    names: Sequence[str]
    translation_m: FloatArray
    rotation: FloatArray


def store(release: Stores, vision: int = 0) -> Typestore:
    """A release of ROS with all families; `vision` chooses the release of vision_msgs."""
    made = get_typestore(release)
    texts: dict[str, str] = {}
    for package, alternatives in KNOWN_DEFINITIONS.items():
        texts.update(alternatives[vision if package == "vision_msgs" else 0])
    if release == Stores.ROS1_NOETIC:
        texts["unique_identifier_msgs/msg/UUID"] = "uint8[16] uuid\n"
        texts["tf2_msgs/msg/TFMessage"] = "geometry_msgs/TransformStamped[] transforms\n"
        name = "vision_msgs/msg/ObjectHypothesisWithPose"
        texts[name] = texts[name].replace("string id", "int64 id")
    types: dict[str, Any] = {}
    for name, text in texts.items():
        types.update(get_types_from_msg(text, name))
    made.register({name: fields for name, fields in types.items() if name not in made.fielddefs})
    return made


def make(types: Typestore, kind: str, values: Mapping[str, Any] | None = None) -> Any:
    """A message from nested plain values; what is not given is zero or empty."""
    given = values or {}
    fields = {
        name: _field(types, field, given.get(name)) for name, field in types.fielddefs[kind][1]
    }
    return types.types[kind](**fields)


def _field(types: Typestore, field: Any, value: Any) -> Any:
    node, argument = field
    if node == Nodetype.NAME:
        return make(types, argument, value)
    if node == Nodetype.BASE:
        empty: Any = "" if argument[0] == "string" else 0.0 if "float" in argument[0] else 0
        if argument[0] == "float32":
            return float(np.float32(value or 0))
        return empty if value is None else value
    inner, count = argument
    if inner[0] == Nodetype.BASE and inner[1][0] != "string":
        dtype = {"bool": "bool", "byte": "uint8", "char": "uint8"}.get(inner[1][0], inner[1][0])
        return np.asarray(
            np.zeros(count)
            if value is None and node == Nodetype.ARRAY
            else []
            if value is None
            else value,
            dtype=dtype,
        )
    return [_field(types, inner, item) for item in value or ()]


def _xyz(values: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyz", map(float, values), strict=True))


def _pose(box: FloatArray) -> dict[str, Any]:
    half = box[6] / 2
    rotation = {"x": 0.0, "y": 0.0, "z": float(np.sin(half)), "w": float(np.cos(half))}
    return {"position": _xyz(box[:3]), "orientation": rotation}


def stamp(time_ns: int) -> dict[str, int]:
    return {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}


def header(frame: LoggedFrame, frame_id: str = FRAME_ID) -> dict[str, Any]:
    return {"stamp": stamp(frame.time_ns), "frame_id": frame_id}


def _objects(frame: LoggedFrame) -> list[tuple[FloatArray, float, str]]:
    return list(zip(frame.boxes, map(float, frame.scores), frame.names, strict=True))


def vision(frame: LoggedFrame) -> dict[str, Any]:
    detections = [
        {
            "results": [
                {"hypothesis": {"class_id": "none", "score": score - 1}},
                {"hypothesis": {"class_id": name, "score": score}},
            ],
            "bbox": {"center": _pose(box), "size": _xyz(box[3:6])},
        }
        for box, score, name in _objects(frame)
    ]
    return {"header": header(frame), "detections": detections}


def vision_foxy(frame: LoggedFrame) -> dict[str, Any]:
    content = vision(frame)
    for detection in content["detections"]:
        detection["results"] = [
            {"id": r["hypothesis"]["class_id"], "score": r["hypothesis"]["score"]}
            for r in detection["results"]
        ]
        detection["source_cloud"] = {"data": [1, 2, 3]}
    return content


_ROS1_IDS = {"none": 0, "car": 1, "pedestrian": 2, "bicycle": 3}


def vision_ros1(frame: LoggedFrame) -> dict[str, Any]:
    content = vision_foxy(frame)
    for detection in content["detections"]:
        for result in detection["results"]:
            result["id"] = _ROS1_IDS[result["id"]]
    return content


_AUTOWARE_LABELS = {"car": 1, "bicycle": 6, "pedestrian": 7}


def autoware(frame: LoggedFrame) -> dict[str, Any]:
    objects = [
        {
            "existence_probability": score,
            "classification": [
                {"label": 0, "probability": 0.1},
                {"label": _AUTOWARE_LABELS[name], "probability": 0.9},
            ],
            "kinematics": {
                "pose_with_covariance": {"pose": _pose(box)},
                "initial_pose_with_covariance": {"pose": _pose(box)},
                "orientation_availability": 2,
            },
            "shape": {"dimensions": _xyz(box[3:6])},
        }
        for box, score, name in _objects(frame)
    ]
    return {"header": header(frame), "objects": objects}


def derived(frame: LoggedFrame) -> dict[str, Any]:
    numbers = {"car": 6, "bicycle": 5, "pedestrian": 4}
    objects = [
        {
            "pose": _pose(box),
            "shape": {"type": 1, "dimensions": box[3:6]},
            "classification": numbers[name],
            "classification_certainty": round(score * 255),
        }
        for box, score, name in _objects(frame)
    ]
    return {"header": header(frame), "objects": objects}


def jsk(frame: LoggedFrame) -> dict[str, Any]:
    boxes = [
        {
            "header": header(frame),
            "pose": _pose(box),
            "dimensions": _xyz(box[3:6]),
            "value": score,
            "label": _ROS1_IDS[name],
        }
        for box, score, name in _objects(frame)
    ]
    return {"header": header(frame), "boxes": boxes}


def radar(frame: LoggedFrame) -> dict[str, Any]:
    numbers = {"car": 32001, "bicycle": 32006, "pedestrian": 32007}
    tracks = [
        {
            "position": _xyz(box[:3]),
            "size": _xyz(box[3:6]),
            "velocity": _xyz((10 * np.cos(box[6]), 10 * np.sin(box[6]), 0.0)),
            "classification": numbers[name],
        }
        for box, _, name in _objects(frame)
    ]
    return {"header": header(frame), "tracks": tracks}


def scene(frame: LoggedFrame) -> dict[str, Any]:
    entities = [
        {
            "timestamp": stamp(frame.time_ns),
            "frame_id": FRAME_ID,
            "id": str(number),
            "metadata": [
                {"key": "category", "value": name},
                {"key": "Score", "value": repr(score)},
            ],
            "cubes": [{"pose": _pose(box), "size": _xyz(box[3:6])}],
        }
        for number, (box, score, name) in enumerate(_objects(frame))
    ]
    return {"entities": entities}


def markers(frame: LoggedFrame) -> dict[str, Any]:
    arrow = {"header": header(frame), "ns": "arrow", "scale": _xyz((1, 1, 1))}
    cubes = [
        {
            "header": header(frame),
            "ns": name,
            "id": number,
            "type": 1,
            "pose": _pose(box),
            "scale": _xyz(box[3:6]),
        }
        for number, (box, _, name) in enumerate(_objects(frame))
    ]
    return {"markers": [arrow, *cubes]}


def transforms(frame: LoggedFrame) -> dict[str, Any]:
    rotation = dict(zip("xyzw", map(float, frame.rotation), strict=True))
    sample = {
        "header": header(frame, WORLD),
        "child_frame_id": FRAME_ID,
        "transform": {"translation": _xyz(frame.translation_m), "rotation": rotation},
    }
    return {"transforms": [sample]}


def frame_transforms(frame: LoggedFrame) -> dict[str, Any]:
    """The same as foxglove says it."""
    sample = {
        "timestamp": stamp(frame.time_ns),
        "parent_frame_id": WORLD,
        "child_frame_id": FRAME_ID,
        "translation": _xyz(frame.translation_m),
        "rotation": dict(zip("xyzw", map(float, frame.rotation), strict=True)),
    }
    return {"transforms": [sample]}


def odometry(frame: LoggedFrame) -> dict[str, Any]:
    rotation = dict(zip("xyzw", map(float, frame.rotation), strict=True))
    pose = {"position": _xyz(frame.translation_m), "orientation": rotation}
    return {
        "header": header(frame, WORLD),
        "child_frame_id": FRAME_ID,
        "pose": {"pose": pose},
    }


Transforms = tuple[str, Callable[[LoggedFrame], dict[str, Any]]]
TF: Transforms = ("tf2_msgs/msg/TFMessage", transforms)
FRAME_TRANSFORMS: Transforms = ("foxglove_msgs/msg/FrameTransforms", frame_transforms)


@dataclass(frozen=True)
class Family:
    """A message type and how frames are written in it.

    Attributes:
        kind: the type.
        content: a frame as nested plain values.
        scored: bits of the scores it says: 64, 32, 8 (of 255), or 0 where it says none.
        classes: how it spells the classes, where that is not their name.
        course: whether it says a velocity and no yaw.
        poses: the transforms beside it: their type, and a frame in it.
    """

    kind: str
    content: Callable[[LoggedFrame], dict[str, Any]]
    scored: int = 64
    classes: Mapping[str, str] | None = None
    course: bool = False
    poses: Transforms = TF


_AUTOWARE = ("autoware_perception_msgs", "autoware_auto_perception_msgs")
_NUMBERS = {name: str(number) for name, number in _ROS1_IDS.items()}
VISION = Family("vision_msgs/msg/Detection3DArray", vision)
VISION_FOXY = Family("vision_msgs/msg/Detection3DArray", vision_foxy)
VISION_ROS1 = Family("vision_msgs/msg/Detection3DArray", vision_ros1, classes=_NUMBERS)
SCENE = Family("foxglove_msgs/msg/SceneUpdate", scene, poses=FRAME_TRANSFORMS)
FAMILIES = (
    *(
        Family(f"{package}/msg/{name}", autoware, 32)
        for package in _AUTOWARE
        for name in ("DetectedObjects", "TrackedObjects", "PredictedObjects")
    ),
    Family("derived_object_msgs/msg/ObjectArray", derived, 8),
    Family("jsk_recognition_msgs/msg/BoundingBoxArray", jsk, 32, _NUMBERS),
    Family("radar_msgs/msg/RadarTracks", radar, 0, course=True),
    Family("visualization_msgs/msg/MarkerArray", markers, 0),
    SCENE,
)
"""All families but vision_msgs, whose layout differs from release to release."""
