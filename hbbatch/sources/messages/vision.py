"""vision_msgs: ROS 2 from Galactic on, ROS 2 Foxy, and ROS 1."""

from __future__ import annotations

from typing import Any

from hbbatch.sources.messages.base import (
    NAN,
    DetectionMessage,
    Item,
    detection_message,
    stamp_ns,
    xyz,
    xyzw,
)


def detection_3d_array(message: Any) -> DetectionMessage:
    """vision_msgs/Detection3DArray: the box is `bbox`, its size along its own axes.

    Score and class are those of the hypothesis that scores highest. Where the array's header names
    no frame, that of the first detection counts.
    """
    items = [_item(detection) for detection in message.detections]
    return detection_message(stamp_ns(message.header.stamp), message.header.frame_id, items)


def _item(detection: Any) -> Item:
    hypotheses = [_hypothesis(result) for result in detection.results]
    score, name = max(hypotheses, key=lambda hypothesis: hypothesis[0], default=(NAN, ""))
    centre = detection.bbox.center
    return Item(
        position_m=xyz(centre.position),
        size_m=xyz(detection.bbox.size),
        rotation=xyzw(centre.orientation),
        score=score,
        class_name=name,
        frame_id=detection.header.frame_id,
    )


def _hypothesis(result: Any) -> tuple[float, str]:
    """Score and class; before Galactic they lie in the result itself, in ROS 1 as a number."""
    if hasattr(result, "hypothesis"):
        return result.hypothesis.score, result.hypothesis.class_id
    return result.score, str(result.id)
