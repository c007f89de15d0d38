"""What a decoded message means: message type to boxes, transforms or poses.

Types are named `package/msg/Type`, whatever the container writes. Another message family is a
module here and its entries in the tables below; decoding it from bytes is not its concern.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from hbbatch.sources.messages import autoware, poses, ros_objects, satellite, shown, vision
from hbbatch.sources.messages.base import DetectionMessage, TransformSample

ReadDetections = Callable[[Any], DetectionMessage]
ReadTransforms = Callable[[Any], Iterable[TransformSample]]

ReadSatellite = Callable[[Any], satellite.Fix | satellite.Orientation | None]

_AUTOWARE: Final = ("autoware_perception_msgs", "autoware_auto_perception_msgs")

DETECTION_MESSAGES: Final[dict[str, ReadDetections]] = {
    "vision_msgs/msg/Detection3DArray": vision.detection_3d_array,
    **{f"{package}/msg/DetectedObjects": autoware.objects for package in _AUTOWARE},
    **{f"{package}/msg/TrackedObjects": autoware.objects for package in _AUTOWARE},
    **{f"{package}/msg/PredictedObjects": autoware.predicted_objects for package in _AUTOWARE},
    "derived_object_msgs/msg/ObjectArray": ros_objects.derived_objects,
    "jsk_recognition_msgs/msg/BoundingBoxArray": ros_objects.jsk_boxes,
    "radar_msgs/msg/RadarTracks": ros_objects.radar_tracks,
    "foxglove_msgs/msg/SceneUpdate": shown.scene_update,
    "visualization_msgs/msg/Marker": shown.marker,
    "visualization_msgs/msg/MarkerArray": shown.marker_array,
}
"""Types that hold detected boxes."""

SHOWN_MESSAGES: Final = frozenset(
    {
        "foxglove_msgs/msg/SceneUpdate",
        "visualization_msgs/msg/Marker",
        "visualization_msgs/msg/MarkerArray",
    }
)
"""Types made to be looked at: they count where a log holds no other detections, or are chosen."""

TRANSFORM_MESSAGES: Final[dict[str, ReadTransforms]] = {
    "tf2_msgs/msg/TFMessage": poses.tf_message,
    "tf/msg/tfMessage": poses.tf_message,
    "foxglove_msgs/msg/FrameTransform": poses.frame_transform,
    "foxglove_msgs/msg/FrameTransforms": poses.frame_transforms,
}
"""Types that hold edges of the transform tree."""

POSE_MESSAGES: Final[dict[str, ReadTransforms]] = {
    "nav_msgs/msg/Odometry": poses.odometry,
    "geometry_msgs/msg/PoseStamped": poses.pose_stamped,
    "geometry_msgs/msg/PoseWithCovarianceStamped": poses.pose_with_covariance_stamped,
    "foxglove_msgs/msg/PoseInFrame": poses.pose_in_frame,
}
"""Types that hold the pose of one frame in another, used where the tree does not reach a world.

The order is the order in which they count."""

SATELLITE_MESSAGES: Final[dict[str, ReadSatellite]] = {
    "sensor_msgs/msg/NavSatFix": satellite.nav_sat_fix,
    "sensor_msgs/msg/Imu": satellite.imu,
}
"""Types that give place and orientation apart, used where nothing else says where anything is."""


def normalise_type(name: str) -> str:
    """`pkg/Type`, `pkg/msg/Type` and `foxglove.Type` as `pkg/msg/Type`; other names unchanged."""
    if name.startswith("foxglove."):
        return f"foxglove_msgs/msg/{name.removeprefix('foxglove.')}"
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else name


__all__ = [
    "DETECTION_MESSAGES",
    "POSE_MESSAGES",
    "SATELLITE_MESSAGES",
    "SHOWN_MESSAGES",
    "TRANSFORM_MESSAGES",
    "DetectionMessage",
    "ReadDetections",
    "ReadTransforms",
    "TransformSample",
    "normalise_type",
]
