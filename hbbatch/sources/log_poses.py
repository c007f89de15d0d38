"""Where the sensor was at each frame of a log: which messages say so, in which order they count.

1. the transform tree (/tf, /tf_static), when it leads from the sensor frame to a world frame;
2. topics of poses, joined to the sensor frame by the tree's static transforms: Odometry, then
   PoseStamped, PoseWithCovarianceStamped and PoseInFrame; of several topics of a type the one with
   the most messages. Types that do not say what they are the pose of are taken to be of the frame
   that static transforms lead to from the sensor;
3. NavSatFix with the orientation of Imu;
4. when nothing in the log says where anything is: identity, recorded as such, with a warning.

A world frame or pose topic that is asked for counts alone. A tree or poses that do not reach the
sensor frame are an error, never replaced by identity.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from hbbatch.errors import SourceError
from hbbatch.sources.base import (
    IDENTITY,
    INTERPOLATED,
    LOGGED,
    Findings,
    IntArray,
    Names,
    Poses,
    SourceOptions,
)
from hbbatch.sources.columns import TransformColumns
from hbbatch.sources.log_satellite import WORLD, SatelliteMessages
from hbbatch.sources.messages import POSE_MESSAGES
from hbbatch.sources.messages.satellite import Fix, Orientation
from hbbatch.sources.transforms import (
    EXTRAPOLATION_NS,
    FramePoses,
    TransformTree,
    frame_name,
    usable,
)

_BOUND_S = EXTRAPOLATION_NS / 1e9
_ORIGINS = (LOGGED, INTERPOLATED, IDENTITY)


@dataclass
class _PoseTopic:
    """The poses of one topic."""

    rank: int
    parent: str = ""
    child: str = ""
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def add(self, columns: TransformColumns, stamps_ns: IntArray) -> None:
        for parent in columns.parents.vocabulary:
            self.parent = self.parent or frame_name(parent)
        for child in columns.children.vocabulary:
            self.child = self.child or frame_name(child)
        self.stamps_ns.frombytes(stamps_ns.tobytes())
        self.values.frombytes(np.ascontiguousarray(columns.values).tobytes())


@dataclass(frozen=True)
class SensorPoses:
    """Poses of one sensor frame.

    Attributes:
        poses: a pose a time.
        known: `(m,)` false where the log does not say; the pose there means nothing.
    """

    poses: Poses
    known: np.ndarray[tuple[int], np.dtype[np.bool_]]


class PoseMessages:
    """Transforms and poses gathered from a log."""

    def __init__(self, options: SourceOptions | None = None) -> None:
        options = options or SourceOptions()
        self.tree = TransformTree()
        self._world_frame = options.world_frame
        self._pose_topic = options.pose_topic
        self._topics: dict[str, _PoseTopic] = {}
        self._satellite = SatelliteMessages()
        self._unusable = 0
        self._noted: set[str] = set()

    def add_transforms(self, topic: str, columns: TransformColumns, log_time_ns: IntArray) -> None:
        """Take edges of the transform tree; those of a topic `…tf_static` hold at all times.

        Args:
            topic: where they were recorded.
            columns: the messages.
            log_time_ns: `(m,)` of the messages; a sample without a stamp counts then.
        """
        kept, stamps_ns = self._usable(columns, log_time_ns)
        self.tree.add(kept, stamps_ns, static=topic.endswith("tf_static"))

    def add_poses(
        self, topic: str, message_type: str, columns: TransformColumns, log_time_ns: IntArray
    ) -> None:
        """Take poses that a topic gives; arguments as above."""
        kept, stamps_ns = self._usable(columns, log_time_ns)
        if len(stamps_ns):
            rank = list(POSE_MESSAGES).index(message_type)
            self._topics.setdefault(topic, _PoseTopic(rank)).add(kept, stamps_ns)

    def _usable(
        self, columns: TransformColumns, log_time_ns: IntArray
    ) -> tuple[TransformColumns, IntArray]:
        """Samples that are transforms, and the times they hold at."""
        of_message = np.repeat(log_time_ns, columns.counts)
        stamps_ns = np.where(columns.stamp_ns == 0, of_message, columns.stamp_ns)
        rows = np.flatnonzero(usable(columns))
        self._unusable += len(stamps_ns) - len(rows)
        kept = replace(
            columns,
            parents=columns.parents[rows],
            children=columns.children[rows],
            stamp_ns=columns.stamp_ns[rows],
            values=columns.values[rows],
        )
        return kept, stamps_ns[rows]

    def add_satellite(self, topic: str, part: Fix | Orientation | None, log_time_ns: int) -> None:
        """Take a satellite fix or an orientation; None: the sender had none."""
        if part is not None:
            self._satellite.add(topic, part, log_time_ns)

    def report(self, findings: Findings) -> None:
        """Write down what was odd in the messages taken."""
        if self._unusable:
            findings.note(f"{self._unusable} transforms left out: not a number, or no rotation")
        for frame in self.tree.ambiguous():
            findings.note(f"frame {frame} has several parents, the one said most often counts")
        ranked = self._ranked_topics()
        if len(ranked) > 1 and self._pose_topic is None:
            findings.note(f"several pose topics ({', '.join(sorted(ranked))}), {ranked[0]} counts")

    def resolve(self, frame: str, stamps_ns: IntArray, findings: Findings) -> SensorPoses:
        """world_from_frame at times.

        Raises:
            SourceError: the log holds poses, but none that reach the frame at any of the times; or
                the world frame or pose topic that was asked for does not.
        """
        reached = False
        for tree, note in self._candidates(frame):
            world = tree.world_of(frame, self._world_frame)
            if world is not None:
                reached = True
                poses = tree.poses(frame, world, stamps_ns)
                if poses.known.any():
                    self._note(note, findings)
                    return _sensor_poses(poses)
        if reached:
            raise SourceError(
                f"no pose of frame {frame!r} within {_BOUND_S} s of any detection: transforms and "
                "detections cover different times. Record both with the same clock."
            )
        self._refuse(frame)
        self._note("no ego poses, identity recorded; tracks will be worse", findings)
        return SensorPoses(Poses.identity(len(stamps_ns)), np.ones(len(stamps_ns), dtype=bool))

    def _note(self, note: str, findings: Findings) -> None:
        """Write a note down once, however many frames it concerns."""
        if note and note not in self._noted:
            self._noted.add(note)
            findings.note(note)

    def _refuse(self, frame: str) -> None:
        """Raise the error of a log whose poses do not reach a frame; none when it has none."""
        known = ", ".join(self._known_frames()) or "none"
        if self._pose_topic is not None and self._pose_topic not in self._topics:
            offered = ", ".join(sorted(self._topics)) or "none"
            raise SourceError(
                f"no poses on topic {self._pose_topic} (--pose-topic). Pose topics: {offered}."
            )
        if self._world_frame is not None:
            raise SourceError(
                f"no transforms lead from frame {frame!r} to {self._world_frame!r} "
                f"(--world-frame). Frames known: {known}."
            )
        if self.tree.moves or self._topics or self._satellite.usable:
            raise SourceError(
                f"no transforms lead from frame {frame!r} to a world frame. Frames known: "
                f"{known}. Record the missing transforms too, or name the world with --world-frame."
            )

    def _candidates(self, frame: str) -> Iterator[tuple[TransformTree, str]]:
        """Trees to try, in order, each with what to note when it counts."""
        if self._pose_topic is None:
            yield self.tree, ""
        for name in self._ranked_topics():
            if self._pose_topic in (None, name):
                yield self._with_topic(self._topics[name], name, frame)
                break
        if self._satellite.usable and self._pose_topic is None:
            tree = self.tree.static_part()
            track = self._satellite.track()
            tree.hang(track.child, WORLD, track.stamps_ns, track.translation_m, track.rotation)
            yield tree, "poses from satellite fixes and Imu orientation: offsets are left out"

    def _ranked_topics(self) -> list[str]:
        """Pose topics, the one that counts first."""

        def rank(name: str) -> tuple[int, int, str]:
            topic = self._topics[name]
            return topic.rank, -len(topic.stamps_ns), name

        return sorted(self._topics, key=rank)

    def _with_topic(self, topic: _PoseTopic, name: str, frame: str) -> tuple[TransformTree, str]:
        tree = self.tree.static_part()
        child = topic.child or tree.static_root(frame)
        note = "" if topic.child else f"{name} says not what it is the pose of: taken as {child!r}"
        values = np.array(topic.values).reshape(-1, 7)
        tree.hang(child, topic.parent, np.array(topic.stamps_ns), values[:, :3], values[:, 3:])
        return tree, note

    def _known_frames(self) -> list[str]:
        named = {t.child for t in self._topics.values()} | {t.parent for t in self._topics.values()}
        return sorted({*self.tree.frames(), *named} - {""})


def _sensor_poses(poses: FramePoses) -> SensorPoses:
    origins = Names(np.where(poses.exact, 0, 1), _ORIGINS)
    return SensorPoses(Poses(poses.translation_m, poses.rotation, origins), poses.known)
