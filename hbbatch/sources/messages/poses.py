"""Transforms and poses of ROS messages."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from hbbatch.sources.messages.base import TransformSample, stamp_ns


def tf_message(message: Any) -> Iterator[TransformSample]:
    """tf2_msgs/TFMessage: each transform takes the child frame to its parent."""
    for stamped in message.transforms:
        transform = stamped.transform
        yield _sample(stamped, transform.translation, transform.rotation)


def odometry(message: Any) -> Iterator[TransformSample]:
    """nav_msgs/Odometry: the pose of the child frame in the header's frame."""
    yield _sample(message, message.pose.pose.position, message.pose.pose.orientation)


def _sample(stamped: Any, position: Any, q: Any) -> TransformSample:
    return TransformSample(
        parent=stamped.header.frame_id,
        child=stamped.child_frame_id,
        stamp_ns=stamp_ns(stamped.header.stamp),
        translation_m=(position.x, position.y, position.z),
        rotation=(q.x, q.y, q.z, q.w),
    )
