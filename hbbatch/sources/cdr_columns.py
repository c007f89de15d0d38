"""Direct walks for the types that make up most of what is decoded.

Each gives what the reader of the same type in `messages` gives, for a whole batch; a batch that it
is not for (another layout of the type, a rare case) is refused and read message by message.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from rosbags.typesys.store import Typestore

from hbbatch.boxes import YAW, FloatArray
from hbbatch.sources.base import IntArray, Names
from hbbatch.sources.blocks import Payloads
from hbbatch.sources.cdr_steps import WalkRefusedError
from hbbatch.sources.cdr_walk import CdrWalk, Columns
from hbbatch.sources.columns import DetectionColumns, TransformColumns
from hbbatch.sources.messages.autoware import label_name
from hbbatch.sources.messages.base import quaternion_yaw

ReadDetectionColumns = Callable[[Payloads], DetectionColumns]
ReadTransformColumns = Callable[[Payloads], TransformColumns]

_STAMP: Final = ("header.stamp.sec", "header.stamp.nanosec")
_FRAME: Final = "header.frame_id"
_POLYGON: Final = 2
_AVAILABLE: Final = 2


def _pose(prefix: str, position: str = "position", rotation: str = "orientation") -> list[str]:
    places = [f"{prefix}.{position}.{axis}" for axis in "xyz"]
    return places + [f"{prefix}.{rotation}.{axis}" for axis in "xyzw"]


def _vector(prefix: str) -> list[str]:
    return [f"{prefix}.{axis}" for axis in "xyz"]


def detection_3d_array(store: Typestore, kind: str) -> ReadDetectionColumns:
    """vision_msgs/Detection3DArray of ROS 2, from Galactic on or before.

    Raises:
        WalkRefusedError: the definition is another one.
    """
    one = "detections[]"
    pose, size = _pose(f"{one}.bbox.center"), _vector(f"{one}.bbox.size")
    inner = f"{one}.header.frame_id"
    common = [*_STAMP, _FRAME, *pose, *size, inner]
    galactic = (f"{one}.results[].hypothesis.score", f"{one}.results[].hypothesis.class_id")
    foxy = (f"{one}.results[].score", f"{one}.results[].id")
    try:
        walk, (score, name) = CdrWalk(store, kind, [*common, *galactic]), galactic
    except WalkRefusedError:
        walk, (score, name) = CdrWalk(store, kind, [*common, *foxy]), foxy

    def read(messages: Payloads) -> DetectionColumns:
        columns = walk.read(messages)
        counts = columns.counts["detections"]
        frames = columns.texts[_FRAME]
        _refuse_other_frames(frames, columns.texts[inner], counts)
        scores, names = _best(columns, score, name, f"{one}.results")
        return DetectionColumns(
            stamp_ns=_stamps(columns, _STAMP),
            frame_ids=frames,
            box_counts=counts,
            boxes=_boxes(columns, pose, size),
            scores=scores,
            class_names=names,
        )

    return read


def autoware_objects(store: Typestore, kind: str) -> ReadDetectionColumns:
    """Autoware's DetectedObjects and TrackedObjects; batches with polygons are refused.

    Raises:
        WalkRefusedError: the definition is another one.
    """
    one = "objects[]"
    pose = _pose(f"{one}.kinematics.pose_with_covariance.pose")
    size, shape = _vector(f"{one}.shape.dimensions"), f"{one}.shape.type"
    existence = f"{one}.existence_probability"
    available = f"{one}.kinematics.orientation_availability"
    score, label = f"{one}.classification[].probability", f"{one}.classification[].label"
    wanted = [*_STAMP, _FRAME, *pose, *size, shape, existence, available, score, label]
    walk = CdrWalk(store, kind, wanted)

    def read(messages: Payloads) -> DetectionColumns:
        columns = walk.read(messages)
        if (columns.numbers[shape] == _POLYGON).any():
            raise WalkRefusedError("a polygon")
        return DetectionColumns(
            stamp_ns=_stamps(columns, _STAMP),
            frame_ids=columns.texts[_FRAME],
            box_counts=columns.counts["objects"],
            boxes=_boxes(columns, pose, size),
            scores=columns.numbers[existence],
            class_names=_best_labels(columns, score, label, f"{one}.classification"),
            unsure_yaws=int((columns.numbers[available] != _AVAILABLE).sum()),
        )

    return read


def tf_message(store: Typestore, kind: str) -> ReadTransformColumns:
    """tf2_msgs/TFMessage.

    Raises:
        WalkRefusedError: the definition is another one.
    """
    one = "transforms[]"
    stamp = tuple(f"{one}.{part}" for part in _STAMP)
    values = _pose(f"{one}.transform", "translation", "rotation")
    parent, child = f"{one}.{_FRAME}", f"{one}.child_frame_id"
    walk = CdrWalk(store, kind, [*stamp, *values, parent, child])

    def read(messages: Payloads) -> TransformColumns:
        columns = walk.read(messages)
        return _transforms(columns, columns.counts["transforms"], stamp, values, parent, child)

    return read


def odometry(store: Typestore, kind: str) -> ReadTransformColumns:
    """nav_msgs/Odometry.

    Raises:
        WalkRefusedError: the definition is another one.
    """
    values = _pose("pose.pose")
    walk = CdrWalk(store, kind, [*_STAMP, _FRAME, "child_frame_id", *values])

    def read(messages: Payloads) -> TransformColumns:
        counts = np.ones(len(messages), dtype=np.int64)
        return _transforms(walk.read(messages), counts, _STAMP, values, _FRAME, "child_frame_id")

    return read


def _stamps(columns: Columns, paths: Sequence[str]) -> IntArray:
    seconds, nanoseconds = (columns.numbers[path] for path in paths)
    total = seconds * 1_000_000_000 + nanoseconds
    return np.where(total >= 0, total, 0)


def _boxes(columns: Columns, pose: list[str], size: list[str]) -> FloatArray:
    # The last column is a place for the yaw.
    boxes = columns.stack([*pose[:3], *size, pose[3]])
    boxes[:, YAW] = quaternion_yaw(columns.stack(pose[3:]))
    return boxes


def _refuse_other_frames(frames: Names, inner: Names, counts: IntArray) -> None:
    """Refuse messages without frame, and objects that name another one than their message."""
    if set(inner.vocabulary) <= {""}:
        return
    numbers = {name: number for number, name in enumerate(frames.vocabulary)}
    table = np.array([numbers.get(name, -1) for name in inner.vocabulary], dtype=np.int64)
    named = np.array([name != "" for name in inner.vocabulary])
    if (named[inner.codes] & (table[inner.codes] != np.repeat(frames.codes, counts))).any():
        raise WalkRefusedError("several frames in a message")


def _best_rows(columns: Columns, score: str, sequence: str) -> tuple[IntArray, IntArray]:
    """Of each object that has hypotheses its number, and the row of the one that scores highest."""
    scores, counts = columns.numbers[score], columns.counts[sequence]
    if np.isnan(scores).any():
        raise WalkRefusedError("a score that is no number")
    objects = np.flatnonzero(counts)
    if len(objects) == len(scores):
        return objects, np.arange(len(scores))
    owners = np.repeat(np.arange(len(counts)), counts)
    order = np.lexsort((-scores, owners))
    return objects, order[np.flatnonzero(np.diff(owners, prepend=-1))]


def _best(columns: Columns, score: str, name: str, sequence: str) -> tuple[FloatArray, Names]:
    """Score and class of the best hypothesis of each object; NaN and empty where it has none."""
    objects, rows = _best_rows(columns, score, sequence)
    count, names = len(columns.counts[sequence]), columns.texts[name]
    scores, codes = np.full(count, np.nan), np.zeros(count, dtype=np.int64)
    scores[objects] = columns.numbers[score][rows]
    codes[objects] = names.codes[rows] + 1
    return scores, Names(codes, ("", *names.vocabulary))


def _best_labels(columns: Columns, score: str, label: str, sequence: str) -> Names:
    """The label of highest probability of each object."""
    objects, rows = _best_rows(columns, score, sequence)
    codes = np.zeros(len(columns.counts[sequence]), dtype=np.int64)
    codes[objects] = columns.numbers[label][rows] + 1
    return Names(codes, (label_name(None), *(label_name(number) for number in range(256))))


def _transforms(
    columns: Columns,
    counts: IntArray,
    stamp: Sequence[str],
    values: list[str],
    parent: str,
    child: str,
) -> TransformColumns:
    return TransformColumns(
        counts=counts,
        parents=columns.texts[parent],
        children=columns.texts[child],
        stamp_ns=_stamps(columns, stamp),
        values=columns.stack(values),
    )


DETECTION_WALKS: Final[dict[str, Callable[[Typestore, str], ReadDetectionColumns]]] = {
    "vision_msgs/msg/Detection3DArray": detection_3d_array,
    **{
        f"{package}/msg/{name}": autoware_objects
        for package in ("autoware_perception_msgs", "autoware_auto_perception_msgs")
        for name in ("DetectedObjects", "TrackedObjects")
    },
}
TRANSFORM_WALKS: Final[dict[str, Callable[[Typestore, str], ReadTransformColumns]]] = {
    "tf2_msgs/msg/TFMessage": tf_message,
    "nav_msgs/msg/Odometry": odometry,
}
