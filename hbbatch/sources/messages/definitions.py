"""Definitions of detection types, for logs that embed none (.db3 before ROS 2 Iron).

Only what the standard ROS packages lack; a type may have several, by the release of its package.
"""

from __future__ import annotations

from typing import Final

_ARRAY: Final = "std_msgs/Header header\n"

_VISION: Final = {
    "vision_msgs/msg/Detection3DArray": f"{_ARRAY}vision_msgs/Detection3D[] detections\n",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
}
_VISION_GALACTIC: Final = {
    **_VISION,
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/Detection3D": (
        f"{_ARRAY}vision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id\n"
    ),
}
_VISION_FOXY: Final = {
    **_VISION,
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "string id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/Detection3D": (
        f"{_ARRAY}vision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nsensor_msgs/PointCloud2 source_cloud\n"
        "bool is_tracking\nstring tracking_id\n"
    ),
}
_DERIVED: Final = {
    "derived_object_msgs/msg/ObjectArray": f"{_ARRAY}derived_object_msgs/Object[] objects\n",
    "derived_object_msgs/msg/Object": (
        f"{_ARRAY}uint32 id\nuint8 detection_level\nbool object_classified\n"
        "geometry_msgs/Pose pose\ngeometry_msgs/Twist twist\ngeometry_msgs/Accel accel\n"
        "geometry_msgs/Polygon polygon\nshape_msgs/SolidPrimitive shape\nuint8 classification\n"
        "uint8 classification_certainty\nuint32 classification_age\n"
    ),
}
_JSK: Final = {
    "jsk_recognition_msgs/msg/BoundingBoxArray": (
        f"{_ARRAY}jsk_recognition_msgs/BoundingBox[] boxes\n"
    ),
    "jsk_recognition_msgs/msg/BoundingBox": (
        f"{_ARRAY}geometry_msgs/Pose pose\ngeometry_msgs/Vector3 dimensions\n"
        "float32 value\nuint32 label\n"
    ),
}
_RADAR: Final = {
    "radar_msgs/msg/RadarTracks": f"{_ARRAY}radar_msgs/RadarTrack[] tracks\n",
    "radar_msgs/msg/RadarTrack": (
        "unique_identifier_msgs/UUID uuid\ngeometry_msgs/Point position\n"
        "geometry_msgs/Vector3 velocity\ngeometry_msgs/Vector3 acceleration\n"
        "geometry_msgs/Vector3 size\nuint16 classification\nfloat32[6] position_covariance\n"
        "float32[6] velocity_covariance\nfloat32[6] acceleration_covariance\n"
        "float32[6] size_covariance\n"
    ),
}


def _autoware(package: str) -> dict[str, str]:
    kinematics = (
        "geometry_msgs/PoseWithCovariance pose_with_covariance\nbool has_position_covariance\n"
        "uint8 orientation_availability\ngeometry_msgs/TwistWithCovariance twist_with_covariance\n"
        "bool has_twist\nbool has_twist_covariance\n"
    )
    tracked_kinematics = (
        "geometry_msgs/PoseWithCovariance pose_with_covariance\n"
        "geometry_msgs/TwistWithCovariance twist_with_covariance\n"
        "geometry_msgs/AccelWithCovariance acceleration_with_covariance\n"
        "uint8 orientation_availability\nbool is_stationary\n"
    )
    common = f"float32 existence_probability\n{package}/ObjectClassification[] classification\n"
    definitions = {
        "DetectedObjects": f"{_ARRAY}{package}/DetectedObject[] objects\n",
        "DetectedObject": (
            f"{common}{package}/DetectedObjectKinematics kinematics\n{package}/Shape shape\n"
        ),
        "DetectedObjectKinematics": kinematics,
        "TrackedObjects": f"{_ARRAY}{package}/TrackedObject[] objects\n",
        "TrackedObject": (
            f"unique_identifier_msgs/UUID object_id\n{common}"
            f"{package}/TrackedObjectKinematics kinematics\n{package}/Shape shape\n"
        ),
        "TrackedObjectKinematics": tracked_kinematics,
        "PredictedObjects": f"{_ARRAY}{package}/PredictedObject[] objects\n",
        "PredictedObject": (
            f"unique_identifier_msgs/UUID object_id\n{common}"
            f"{package}/PredictedObjectKinematics kinematics\n{package}/Shape shape\n"
        ),
        "PredictedObjectKinematics": (
            "geometry_msgs/PoseWithCovariance initial_pose_with_covariance\n"
            "geometry_msgs/TwistWithCovariance initial_twist_with_covariance\n"
            "geometry_msgs/AccelWithCovariance initial_acceleration_with_covariance\n"
            f"{package}/PredictedPath[] predicted_paths\n"
        ),
        "PredictedPath": (
            "geometry_msgs/Pose[] path\nbuiltin_interfaces/Duration time_step\nfloat32 confidence\n"
        ),
        "ObjectClassification": "uint8 label\nfloat32 probability\n",
        "Shape": "uint8 type\ngeometry_msgs/Polygon footprint\ngeometry_msgs/Vector3 dimensions\n",
    }
    return {f"{package}/msg/{name}": text for name, text in definitions.items()}


def _foxglove() -> dict[str, str]:
    """foxglove_msgs as of 2022 on, as generated for ROS."""
    pose, color = "geometry_msgs/Pose pose\n", "foxglove_msgs/Color color\n"
    drawn = f"{color}foxglove_msgs/Color[] colors\nuint32[] indices\n"
    size = "geometry_msgs/Vector3 size\n"
    stamped = "builtin_interfaces/Time timestamp\n"
    shapes = ["Arrow", "Cube", "Sphere", "Cylinder", "Line", "TriangleList", "Text", "Model"]
    fields = ["arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models"]
    primitives = "".join(
        f"foxglove_msgs/{shape}Primitive[] {field}\n"
        for shape, field in zip(shapes, fields, strict=True)
    )
    definitions = {
        "SceneUpdate": (
            "foxglove_msgs/SceneEntityDeletion[] deletions\nfoxglove_msgs/SceneEntity[] entities\n"
        ),
        "SceneEntityDeletion": f"{stamped}uint8 type\nstring id\n",
        "SceneEntity": (
            f"{stamped}string frame_id\nstring id\nbuiltin_interfaces/Duration lifetime\n"
            f"bool frame_locked\nfoxglove_msgs/KeyValuePair[] metadata\n{primitives}"
        ),
        "KeyValuePair": "string key\nstring value\n",
        "Color": "float64 r\nfloat64 g\nfloat64 b\nfloat64 a\n",
        "ArrowPrimitive": (
            f"{pose}float64 shaft_length\nfloat64 shaft_diameter\nfloat64 head_length\n"
            f"float64 head_diameter\n{color}"
        ),
        "CubePrimitive": f"{pose}{size}{color}",
        "SpherePrimitive": f"{pose}{size}{color}",
        "CylinderPrimitive": f"{pose}{size}float64 bottom_scale\nfloat64 top_scale\n{color}",
        "LinePrimitive": (
            f"uint8 type\n{pose}float64 thickness\nbool scale_invariant\n"
            f"geometry_msgs/Point[] points\n{drawn}"
        ),
        "TriangleListPrimitive": f"{pose}geometry_msgs/Point[] points\n{drawn}",
        "TextPrimitive": (
            f"{pose}bool billboard\nfloat64 font_size\nbool scale_invariant\n{color}string text\n"
        ),
        "ModelPrimitive": (
            f"{pose}geometry_msgs/Vector3 scale\n{color}bool override_color\nstring url\n"
            "string media_type\nuint8[] data\n"
        ),
        "FrameTransform": (
            f"{stamped}string parent_frame_id\nstring child_frame_id\n"
            "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
        ),
        "FrameTransforms": "foxglove_msgs/FrameTransform[] transforms\n",
        "PoseInFrame": f"{stamped}string frame_id\n{pose}",
    }
    return {f"foxglove_msgs/msg/{name}": text for name, text in definitions.items()}


KNOWN_DEFINITIONS: Final[dict[str, tuple[dict[str, str], ...]]] = {
    "vision_msgs": (_VISION_GALACTIC, _VISION_FOXY),
    "derived_object_msgs": (_DERIVED,),
    "jsk_recognition_msgs": (_JSK,),
    "radar_msgs": (_RADAR,),
    "autoware_perception_msgs": (_autoware("autoware_perception_msgs"),),
    "autoware_auto_perception_msgs": (_autoware("autoware_auto_perception_msgs"),),
    "foxglove_msgs": (_foxglove(),),
}
"""Package to its definitions, type to text; the newest release first."""
