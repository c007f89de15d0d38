"""Transforms and poses of ROS and foxglove messages."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from hbbatch.sources.messages.base import TransformSample, stamp_ns, xyz, xyzw


def tf_message(message: Any) -> Iterator[TransformSample]:
    """tf2_msgs/TFMessage and tf/tfMessage: each transform takes the child frame to its parent."""
    for stamped in message.transforms:
        transform = stamped.transform
        yield _sample(stamped, stamped.child_frame_id, transform.translation, transform.rotation)


def odometry(message: Any) -> Iterator[TransformSample]:
    """nav_msgs/Odometry: the pose of the child frame in the header's frame."""
    pose = message.pose.pose
    yield _sample(message, message.child_frame_id, pose.position, pose.orientation)


def pose_stamped(message: Any) -> Iterator[TransformSample]:
    """geometry_msgs/PoseStamped: a pose in the header's frame, of what it does not say."""
    yield _sample(message, "", message.pose.position, message.pose.orientation)


def pose_with_covariance_stamped(message: Any) -> Iterator[TransformSample]:
    """geometry_msgs/PoseWithCovarianceStamped: as PoseStamped, a level deeper."""
    yield _sample(message, "", message.pose.pose.position, message.pose.pose.orientation)


def frame_transform(message: Any) -> Iterator[TransformSample]:
    """foxglove.FrameTransform."""
    yield TransformSample(
        parent=message.parent_frame_id,
        child=message.child_frame_id,
        stamp_ns=stamp_ns(message.timestamp),
        translation_m=xyz(message.translation),
        rotation=xyzw(message.rotation),
    )


def frame_transforms(message: Any) -> Iterator[TransformSample]:
    """foxglove.FrameTransforms."""
    for transform in message.transforms:
        yield from frame_transform(transform)


def pose_in_frame(message: Any) -> Iterator[TransformSample]:
    """foxglove.PoseInFrame: a pose in a frame, of what it does not say."""
    yield TransformSample(
        parent=message.frame_id,
        child="",
        stamp_ns=stamp_ns(message.timestamp),
        translation_m=xyz(message.pose.position),
        rotation=xyzw(message.pose.orientation),
    )


def _sample(stamped: Any, child: str, position: Any, rotation: Any) -> TransformSample:
    return TransformSample(
        parent=stamped.header.frame_id,
        child=child,
        stamp_ns=stamp_ns(stamped.header.stamp),
        translation_m=xyz(position),
        rotation=xyzw(rotation),
    )
