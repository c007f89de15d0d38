"""What a decoded message means: message type to boxes, transforms or poses.

Types are named `package/msg/Type`, whatever the container writes. Another message family is a
module here and its entries in the tables below; decoding it from bytes is not its concern.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from hbbatch.sources.messages import poses, vision
from hbbatch.sources.messages.base import DetectionMessage, TransformSample

DETECTION_MESSAGES: Final[dict[str, Callable[[Any], DetectionMessage]]] = {
    "vision_msgs/msg/Detection3DArray": vision.detection_3d_array,
}
"""Types that hold detected boxes."""

TRANSFORM_MESSAGES: Final[dict[str, Callable[[Any], Iterable[TransformSample]]]] = {
    "tf2_msgs/msg/TFMessage": poses.tf_message,
}
"""Types that hold edges of the transform tree."""

POSE_MESSAGES: Final[dict[str, Callable[[Any], Iterable[TransformSample]]]] = {
    "nav_msgs/msg/Odometry": poses.odometry,
}
"""Types that hold the pose of one frame in another, used where the tree does not reach a world."""


def normalise_type(name: str) -> str:
    """`pkg/Type` and `pkg/msg/Type` as `pkg/msg/Type`; other names unchanged."""
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else name


__all__ = [
    "DETECTION_MESSAGES",
    "POSE_MESSAGES",
    "TRANSFORM_MESSAGES",
    "DetectionMessage",
    "TransformSample",
    "normalise_type",
]
