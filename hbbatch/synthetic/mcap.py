"""A simulated drive as the log a ROS 2 vehicle would have recorded.

Channels, all CDR with `ros2msg` schemas: /detections (vision_msgs/Detection3DArray in the frame
`lidar`), /tf (odom to base_link), /tf_static (base_link to lidar), /odom (nav_msgs/Odometry).
Header stamps are the frame's; log times are later, as if by the time computing took.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from hbbatch.boxes import FloatArray
from hbbatch.dataset import write_aside
from hbbatch.synthetic.drive import Drive, DriveFrame
from hbbatch.synthetic.sensor import Pose
from hbbatch.synthetic.settings import CLASS_NAMES

WORLD_FRAME: Final = "odom"
BASE_FRAME: Final = "base_link"
SENSOR_FRAME: Final = "lidar"

_ARRAY: Final = "vision_msgs/msg/Detection3DArray"
_TRANSFORMS: Final = "tf2_msgs/msg/TFMessage"
_ODOMETRY: Final = "nav_msgs/msg/Odometry"
_DETECTOR_LATENCY_NS: Final = 85_000_000
_POSE_LATENCY_NS: Final = 4_000_000

# Fields of vision_msgs 4 (ROS 2, Galactic on); rosbags does not know the package.
_VISION_MSGS: Final = {
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id"
    ),
    "Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}


def write_mcap(drive: Drive, path: Path) -> None:
    """Write a drive; the same drive gives the same bytes.

    Raises:
        DatasetError: the file cannot be written.
    """
    with write_aside(path) as aside, aside.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="hbbatch")
        log = _Log(writer)
        first = drive.frames[0].timestamp_ns
        log.add("/tf_static", _TRANSFORMS, _mounting(drive, first), first)
        for frame in drive.frames:
            base = _base_pose(frame.logged_pose, drive.settings.sensor.height_m)
            pose_time_ns = frame.timestamp_ns + _POSE_LATENCY_NS
            log.add("/tf", _TRANSFORMS, _moving(base, frame.timestamp_ns), pose_time_ns)
            log.add("/odom", _ODOMETRY, _odometry(base, frame), pose_time_ns)
            detected_ns = frame.timestamp_ns + _DETECTOR_LATENCY_NS
            log.add("/detections", _ARRAY, _detections(frame), detected_ns)
        writer.finish()  # type: ignore[no-untyped-call]


class _Log:
    """Messages into channels, a channel made when its first message comes."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._channels: dict[str, int] = {}

    def add(self, topic: str, type_name: str, message: Any, log_time_ns: int) -> None:
        channel = self._channels.get(topic) or self._channel(topic, type_name)
        data = bytes(_types().serialize_cdr(message, type_name))
        self._writer.add_message(channel, log_time_ns, data, log_time_ns)

    def _channel(self, topic: str, type_name: str) -> int:
        definition, _ = _types().generate_msgdef(type_name, ros_version=2)
        schema = self._writer.register_schema(type_name, "ros2msg", definition.encode())
        self._channels[topic] = self._writer.register_channel(topic, "cdr", schema)
        return self._channels[topic]


@functools.cache
def _types() -> Any:
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, definition in _VISION_MSGS.items():
        store.register(get_types_from_msg(definition, f"vision_msgs/msg/{name}"))
    return store


def _make(type_name: str, *values: Any) -> Any:
    """A message from the values of its fields, in order."""
    return _types().types[type_name](*values)


def _header(stamp_ns: int, frame_id: str) -> Any:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    stamp = _make("builtin_interfaces/msg/Time", seconds, nanoseconds)
    return _make("std_msgs/msg/Header", stamp, frame_id)


def _quaternion(rotation: Rotation) -> Any:
    return _make("geometry_msgs/msg/Quaternion", *map(float, rotation.as_quat()))


def _vector(xyz: FloatArray, kind: str = "Vector3") -> Any:
    return _make(f"geometry_msgs/msg/{kind}", *map(float, xyz))


def _pose(position: FloatArray, rotation: Rotation) -> Any:
    return _make("geometry_msgs/msg/Pose", _vector(position, "Point"), _quaternion(rotation))


def _transform(
    position: FloatArray, rotation: Rotation, stamp_ns: int, parent: str, child: str
) -> Any:
    transform = _make("geometry_msgs/msg/Transform", _vector(position), _quaternion(rotation))
    stamped = _make(
        "geometry_msgs/msg/TransformStamped", _header(stamp_ns, parent), child, transform
    )
    return _make(_TRANSFORMS, [stamped])


def _base_pose(sensor: Pose, height_m: float) -> Pose:
    """The vehicle's pose on the ground, below its sensor."""
    return Pose(sensor.rotation, sensor.translation_m - height_m * sensor.rotation[:, 2])


def _mounting(drive: Drive, stamp_ns: int) -> Any:
    up = np.array([0.0, 0.0, drive.settings.sensor.height_m])
    return _transform(up, Rotation.identity(), stamp_ns, BASE_FRAME, SENSOR_FRAME)


def _moving(base: Pose, stamp_ns: int) -> Any:
    rotation = Rotation.from_matrix(base.rotation)
    return _transform(base.translation_m, rotation, stamp_ns, WORLD_FRAME, BASE_FRAME)


def _odometry(base: Pose, frame: DriveFrame) -> Any:
    unknown = np.zeros(36)
    pose = _pose(base.translation_m, Rotation.from_matrix(base.rotation))
    forward, turn = (
        np.array([frame.speed_m_s, 0.0, 0.0]),
        np.array([0.0, 0.0, frame.yaw_rate_rad_s]),
    )
    twist = _make("geometry_msgs/msg/Twist", _vector(forward), _vector(turn))
    return _make(
        _ODOMETRY,
        _header(frame.timestamp_ns, WORLD_FRAME),
        BASE_FRAME,
        _make("geometry_msgs/msg/PoseWithCovariance", pose, unknown),
        _make("geometry_msgs/msg/TwistWithCovariance", twist, unknown),
    )


def _detections(frame: DriveFrame) -> Any:
    header = _header(frame.timestamp_ns, SENSOR_FRAME)
    said = frame.detections
    rows = zip(said.boxes, said.scores, said.class_codes, strict=True)
    detections = [
        _detection(header, box, float(score), CLASS_NAMES[code]) for box, score, code in rows
    ]
    return _make(_ARRAY, header, detections)


def _detection(header: Any, box: FloatArray, score: float, class_name: str) -> Any:
    pose = _pose(box[:3], Rotation.from_euler("z", box[6]))
    hypothesis = _make("vision_msgs/msg/ObjectHypothesis", class_name, score)
    with_pose = _make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
    result = _make("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis, with_pose)
    bounds = _make("vision_msgs/msg/BoundingBox3D", pose, _vector(box[3:6]))
    return _make("vision_msgs/msg/Detection3D", header, [result], bounds, "")
