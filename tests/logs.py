"""Small logs written by tests: ROS 2 messages in MCAP files, built from plain numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

_TIME = "int32 sec\nuint32 nanosec\n"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
_POINT = "float64 x\nfloat64 y\nfloat64 z\n"
_QUATERNION = "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"

DEFINITIONS: Mapping[str, str] = {
    "builtin_interfaces/msg/Time": _TIME,
    "std_msgs/msg/Header": _HEADER,
    "std_msgs/msg/String": "string data\n",
    "geometry_msgs/msg/Point": _POINT,
    "geometry_msgs/msg/Vector3": _POINT,
    "geometry_msgs/msg/Quaternion": _QUATERNION,
    "geometry_msgs/msg/Pose": (
        "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
    ),
    "geometry_msgs/msg/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
    "geometry_msgs/msg/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "geometry_msgs/msg/TwistWithCovariance": (
        "geometry_msgs/Twist twist\nfloat64[36] covariance\n"
    ),
    "geometry_msgs/msg/Transform": (
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
    ),
    "geometry_msgs/msg/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
    ),
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "nav_msgs/msg/Odometry": (
        "std_msgs/Header header\nstring child_frame_id\n"
        "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist\n"
    ),
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id\n"
    ),
    "vision_msgs/msg/Detection3DArray": (
        "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n"
    ),
}


def _typestore() -> Any:
    store = get_typestore(Stores.EMPTY)
    types: dict[str, Any] = {}
    for name, text in DEFINITIONS.items():
        types.update(get_types_from_msg(text, name))
    store.register(types)
    return store


STORE = _typestore()


def definition(name: str) -> str:
    """A definition with all it refers to behind it, as recorders embed it."""
    text, pending, done = DEFINITIONS[name], _parts(name), set()
    while pending:
        part = pending.pop(0)
        if part not in done:
            done.add(part)
            pending += _parts(part)
            text += f"{'=' * 80}\nMSG: {part.replace('/msg/', '/')}\n{DEFINITIONS[part]}"
    return text


def _parts(name: str) -> list[str]:
    kinds = [line.split()[0].partition("[")[0] for line in DEFINITIONS[name].splitlines()]
    return [kind.replace("/", "/msg/") for kind in kinds if "/" in kind]


def message(kind: str, **fields: Any) -> Any:
    """A message object of a type, its fields in order of the definition."""
    return STORE.types[kind](**fields)


def stamp(time_ns: int) -> Any:
    return message("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)


def header(time_ns: int, frame_id: str) -> Any:
    return message("std_msgs/msg/Header", stamp=stamp(time_ns), frame_id=frame_id)


def xyz(kind: str, values: Sequence[float]) -> Any:
    x, y, z = (float(value) for value in values)
    return message(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def quaternion(values: Sequence[float]) -> Any:
    x, y, z, w = (float(value) for value in values)
    return message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def about_z(yaw: float) -> tuple[float, float, float, float]:
    return (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))


def pose(position: Sequence[float], rotation: Sequence[float]) -> Any:
    return message(
        "geometry_msgs/msg/Pose",
        position=xyz("Point", position),
        orientation=quaternion(rotation),
    )


def pose_with_covariance(position: Sequence[float], rotation: Sequence[float]) -> Any:
    return message(
        "geometry_msgs/msg/PoseWithCovariance",
        pose=pose(position, rotation),
        covariance=np.zeros(36),
    )


def detection(
    box: Sequence[float], hypotheses: Sequence[tuple[str, float]], frame_id: str = ""
) -> Any:
    """A Detection3D from a box `[x, y, z, length, width, height, yaw]`."""
    results = [
        message(
            "vision_msgs/msg/ObjectHypothesisWithPose",
            hypothesis=message("vision_msgs/msg/ObjectHypothesis", class_id=name, score=score),
            pose=pose_with_covariance((0, 0, 0), (0, 0, 0, 1)),
        )
        for name, score in hypotheses
    ]
    return message(
        "vision_msgs/msg/Detection3D",
        header=header(0, frame_id),
        results=results,
        bbox=message(
            "vision_msgs/msg/BoundingBox3D",
            center=pose(box[:3], about_z(box[6])),
            size=xyz("Vector3", box[3:6]),
        ),
        id="",
    )


def detections(time_ns: int, frame_id: str, items: Sequence[Any]) -> Any:
    return message(
        "vision_msgs/msg/Detection3DArray",
        header=header(time_ns, frame_id),
        detections=list(items),
    )


def transform(
    time_ns: int,
    parent: str,
    child: str,
    translation: Sequence[float],
    rotation: Sequence[float] = (0, 0, 0, 1),
) -> Any:
    """A TFMessage with one transform."""
    stamped = message(
        "geometry_msgs/msg/TransformStamped",
        header=header(time_ns, parent),
        child_frame_id=child,
        transform=message(
            "geometry_msgs/msg/Transform",
            translation=xyz("Vector3", translation),
            rotation=quaternion(rotation),
        ),
    )
    return message("tf2_msgs/msg/TFMessage", transforms=[stamped])


def odometry(
    time_ns: int,
    parent: str,
    child: str,
    position: Sequence[float],
    rotation: Sequence[float] = (0, 0, 0, 1),
) -> Any:
    still = message(
        "geometry_msgs/msg/Twist",
        linear=xyz("Vector3", (0, 0, 0)),
        angular=xyz("Vector3", (0, 0, 0)),
    )
    return message(
        "nav_msgs/msg/Odometry",
        header=header(time_ns, parent),
        child_frame_id=child,
        pose=pose_with_covariance(position, rotation),
        twist=message(
            "geometry_msgs/msg/TwistWithCovariance", twist=still, covariance=np.zeros(36)
        ),
    )


@dataclass
class LogWriter:
    """Messages in the order in which they are to lie in the file."""

    messages: list[tuple[str, int, Any]] = field(default_factory=list)

    def add(self, topic: str, log_time_ns: int, content: Any) -> LogWriter:
        self.messages.append((topic, log_time_ns, content))
        return self

    def write(
        self,
        path: Path,
        *,
        chunk_size: int = 1024 * 1024,
        compression: CompressionType = CompressionType.ZSTD,
        schema_text: Mapping[str, str] | None = None,
        **options: bool,
    ) -> Path:
        """Write an MCAP file; `schema_text` replaces the definition of a type."""
        with path.open("wb") as file:
            writer = Writer(file, chunk_size, compression, **options)
            writer.start(profile="ros2")
            channels: dict[str, int] = {}
            for topic, log_time_ns, content in self.messages:
                kind = content.__msgtype__
                if topic not in channels:
                    text = (schema_text or {}).get(kind) or definition(kind)
                    schema = writer.register_schema(kind, "ros2msg", text.encode())
                    channels[topic] = writer.register_channel(topic, "cdr", schema)
                data = bytes(STORE.serialize_cdr(content, kind))
                writer.add_message(channels[topic], log_time_ns, data, log_time_ns)
            writer.finish()
        return path
