"""Where the sensor was at each frame of a log: which messages say so, in which order they count.

1. the transform tree (/tf, /tf_static), when it leads from the sensor frame to a world frame;
2. Odometry, joined to the sensor frame by the tree's static transforms; of several topics the one
   with the most messages;
3. when nothing in the log says where anything is: identity, recorded as such, with a warning.

A tree or odometry that does not reach the sensor frame is an error, never replaced by identity.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hbbatch.errors import SourceError
from hbbatch.sources.base import IDENTITY_POSE, INTERPOLATED, LOGGED, Findings, IntArray, Pose
from hbbatch.sources.messages import TransformSample
from hbbatch.sources.transforms import EXTRAPOLATION_NS, FramePoses, TransformTree

_BOUND_S = EXTRAPOLATION_NS / 1e9


class PoseMessages:
    """Transforms and poses gathered from a log."""

    def __init__(self) -> None:
        self._tree = TransformTree()
        self._odometry: dict[str, list[tuple[TransformSample, int]]] = {}
        self._unusable = 0

    def add_transform(self, topic: str, sample: TransformSample, log_time_ns: int) -> None:
        """Take an edge of the transform tree; those of a topic `…tf_static` hold at all times."""
        static = topic.endswith("tf_static")
        self._unusable += not self._tree.add(sample, log_time_ns, static=static)

    def add_pose(self, topic: str, sample: TransformSample, log_time_ns: int) -> None:
        """Take a pose that a topic gives."""
        self._odometry.setdefault(topic, []).append((sample, log_time_ns))

    def report(self, findings: Findings) -> None:
        """Write down what was odd in the messages taken."""
        if self._unusable:
            findings.note(f"{self._unusable} transforms left out: not a number, or no rotation")
        for frame in self._tree.ambiguous():
            findings.note(f"frame {frame} has several parents, the one said most often counts")
        if len(self._odometry) > 1:
            findings.note(f"several odometry topics, {self._odometry_topic()} counts")

    def resolve(self, frame: str, stamps_ns: IntArray, findings: Findings) -> Sequence[Pose | None]:
        """world_from_frame at times, None where the log does not say.

        Raises:
            SourceError: the log holds poses, but none that reach the frame at any of the times.
        """
        reached = False
        for tree in self._candidates():
            world = tree.world_of(frame)
            if world is not None:
                reached = True
                poses = tree.poses(frame, world, stamps_ns)
                if poses.known.any():
                    return list(_poses(poses))
        if reached:
            raise SourceError(
                f"no pose of frame {frame!r} within {_BOUND_S} s of any detection: transforms and "
                "detections cover different times. Record both with the same clock."
            )
        if self._tree.moves or self._odometry:
            raise SourceError(
                f"no transforms lead from frame {frame!r} to a world frame. Frames known: "
                f"{', '.join(self._known_frames())}. Record the missing transforms too."
            )
        findings.note("no ego poses, identity recorded; tracks will be worse")
        return [IDENTITY_POSE] * len(stamps_ns)

    def _candidates(self) -> Iterator[TransformTree]:
        yield self._tree
        if self._odometry:
            yield self._odometry_tree()

    def _odometry_topic(self) -> str:
        return max(sorted(self._odometry), key=lambda topic: len(self._odometry[topic]))

    def _odometry_tree(self) -> TransformTree:
        tree = self._tree.static_part()
        for sample, log_time_ns in self._odometry[self._odometry_topic()]:
            tree.add(sample, log_time_ns, static=False)
        return tree

    def _known_frames(self) -> list[str]:
        return sorted({name for tree in self._candidates() for name in tree.frames()})


def _poses(poses: FramePoses) -> Iterator[Pose | None]:
    columns = (poses.translation_m, poses.rotation, poses.exact, poses.known)
    for translation_m, rotation, exact, known in zip(*columns, strict=True):
        origin = LOGGED if exact else INTERPOLATED
        yield Pose(translation_m, rotation, origin) if known else None
