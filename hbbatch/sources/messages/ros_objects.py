"""Object lists of ROS packages that each come with one type: derived objects, jsk, radar."""

from __future__ import annotations

from math import atan2, hypot
from typing import Any, Final

from hbbatch.sources.messages.base import (
    NAN,
    NO_ROTATION,
    DetectionMessage,
    Item,
    detection_message,
    stamp_ns,
    xyz,
    xyzw,
)

_DERIVED: Final = {
    4: "pedestrian",
    5: "bicycle",
    6: "car",
    7: "truck",
    8: "motorcycle",
    9: "other_vehicle",
    10: "barrier",
    11: "sign",
}
_RADAR: Final = {
    32001: "car",
    32002: "truck",
    32003: "bus",
    32004: "trailer",
    32005: "motorcycle",
    32006: "bicycle",
    32007: "pedestrian",
}
_MOVING_M_S: Final = 0.5
_FULL_CERTAINTY: Final = 255
_SOLID_BOX: Final = 1
_NO_SIZE: Final = (0.0, 0.0, 0.0)


def derived_objects(message: Any) -> DetectionMessage:
    """derived_object_msgs/ObjectArray: the box is the solid primitive of each object."""
    items = [_derived(item) for item in message.objects]
    return detection_message(stamp_ns(message.header.stamp), message.header.frame_id, items)


def _derived(item: Any) -> Item:
    is_box = item.shape.type == _SOLID_BOX and len(item.shape.dimensions) >= 3
    length, width, height = item.shape.dimensions[:3] if is_box else _NO_SIZE
    return Item(
        position_m=xyz(item.pose.position),
        size_m=(float(length), float(width), float(height)),
        rotation=xyzw(item.pose.orientation),
        score=item.classification_certainty / _FULL_CERTAINTY,
        class_name=_DERIVED.get(item.classification, "unknown"),
        frame_id=item.header.frame_id,
    )


def jsk_boxes(message: Any) -> DetectionMessage:
    """jsk_recognition_msgs/BoundingBoxArray: labels are numbers whose meaning the log lacks."""
    items = [
        Item(
            position_m=xyz(box.pose.position),
            size_m=xyz(box.dimensions),
            rotation=xyzw(box.pose.orientation),
            score=box.value,
            class_name=str(box.label),
            frame_id=box.header.frame_id,
        )
        for box in message.boxes
    ]
    return detection_message(stamp_ns(message.header.stamp), message.header.frame_id, items)


def radar_tracks(message: Any) -> DetectionMessage:
    """radar_msgs/RadarTracks: no yaw is sent; that of the velocity counts where a track moves."""
    items = [
        Item(
            position_m=xyz(track.position),
            size_m=xyz(track.size),
            rotation=NO_ROTATION,
            score=NAN,
            class_name=_RADAR.get(track.classification, "unknown"),
            yaw=_course(track.velocity),
        )
        for track in message.tracks
    ]
    still = sum(hypot(t.velocity.x, t.velocity.y) < _MOVING_M_S for t in message.tracks)
    return detection_message(stamp_ns(message.header.stamp), message.header.frame_id, items, still)


def _course(velocity: Any) -> float:
    moves = hypot(velocity.x, velocity.y) >= _MOVING_M_S
    return atan2(velocity.y, velocity.x) if moves else 0.0
