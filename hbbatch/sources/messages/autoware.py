"""Autoware: objects of autoware_perception_msgs and autoware_auto_perception_msgs."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from hbbatch.sources.messages.base import (
    DetectionMessage,
    Item,
    detection_message,
    quaternion_yaw,
    stamp_ns,
    xyz,
    xyzw,
)

LABELS: Final = (
    "unknown",
    "car",
    "truck",
    "bus",
    "trailer",
    "motorcycle",
    "bicycle",
    "pedestrian",
    "animal",
    "hazard",
    "over_drivable",
    "under_drivable",
)
_POLYGON: Final = 2
_AVAILABLE: Final = 2


def objects(message: Any) -> DetectionMessage:
    """DetectedObjects and TrackedObjects.

    A cylinder's dimensions are its diameter twice and its height. Of a polygon the rectangle about
    its footprint counts, along the axes of the object's pose. An orientation that is unavailable or
    of unknown sign keeps the yaw as logged, and is counted.
    """
    unsure = sum(
        getattr(detected.kinematics, "orientation_availability", _AVAILABLE) != _AVAILABLE
        for detected in message.objects
    )
    items = [_item(o, o.kinematics.pose_with_covariance.pose) for o in message.objects]
    return detection_message(stamp_ns(message.header.stamp), message.header.frame_id, items, unsure)


def predicted_objects(message: Any) -> DetectionMessage:
    """PredictedObjects: where the objects are now; their predicted paths are not read."""
    items = [_item(o, o.kinematics.initial_pose_with_covariance.pose) for o in message.objects]
    return detection_message(stamp_ns(message.header.stamp), message.header.frame_id, items)


def _item(detected: Any, pose: Any) -> Item:
    position, size = xyz(pose.position), xyz(detected.shape.dimensions)
    rotation = xyzw(pose.orientation)
    points = detected.shape.footprint.points
    if detected.shape.type == _POLYGON and len(points):
        yaw = float(quaternion_yaw(np.array([rotation], dtype=np.float64))[0])
        position, size = _around(points, position, size[2], yaw)
    label = max(detected.classification, key=lambda c: c.probability, default=None)
    return Item(
        position, size, rotation, detected.existence_probability, label_name(label and label.label)
    )


def label_name(label: int | None) -> str:
    """Name of a label; a number that has none is given as a number."""
    if label is None:
        return LABELS[0]
    return LABELS[label] if 0 <= label < len(LABELS) else str(label)


def _around(
    points: Any, position_m: tuple[float, float, float], height_m: float, yaw: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Centre and size of the rectangle about a footprint, given in the object's own axes."""
    corners = np.array([(point.x, point.y) for point in points], dtype=np.float64)
    low, high = corners.min(axis=0), corners.max(axis=0)
    x, y = (low + high) / 2
    turned = (x * np.cos(yaw) - y * np.sin(yaw), x * np.sin(yaw) + y * np.cos(yaw))
    length_m, width_m = high - low
    centre = (position_m[0] + float(turned[0]), position_m[1] + float(turned[1]), position_m[2])
    return centre, (float(length_m), float(width_m), height_m)
