"""Messages as columns: a batch of messages, read one by one or walked together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.sources.base import IntArray, Names
from hbbatch.sources.messages import DetectionMessage, TransformSample


@dataclass(frozen=True)
class DetectionColumns:
    """A batch of detection messages.

    Attributes:
        stamp_ns: `(m,)` header stamps, 0 when unset.
        frame_ids: m frames of the boxes, as written.
        box_counts: `(m,)`; the boxes of all messages follow one another.
        boxes: `(n, 7)`.
        scores: `(n,)`, NaN where there is none.
        class_names: n names.
        foreign: boxes left out because they are in another frame than the message.
        unsure_yaws: boxes whose yaw the sender marks as unknown or possibly off by π.
    """

    stamp_ns: IntArray
    frame_ids: Names
    box_counts: IntArray
    boxes: FloatArray
    scores: FloatArray
    class_names: Names
    foreign: int = 0
    unsure_yaws: int = 0


@dataclass(frozen=True)
class TransformColumns:
    """A batch of messages of transforms or poses.

    Attributes:
        counts: `(m,)` samples of each message; the samples of all messages follow one another.
        parents: n frames.
        children: n frames, empty where a message does not say what the pose is of.
        stamp_ns: `(n,)`, 0 when unset.
        values: `(n, 7)` translation in metres, quaternion x, y, z, w of any length.
    """

    counts: IntArray
    parents: Names
    children: Names
    stamp_ns: IntArray
    values: FloatArray


def from_samples(messages: Sequence[Sequence[TransformSample]]) -> TransformColumns:
    """Columns of samples that were read message by message."""
    samples = [sample for message in messages for sample in message]
    values = [(*sample.translation_m, *sample.rotation) for sample in samples]
    return TransformColumns(
        counts=np.array([len(message) for message in messages], dtype=np.int64),
        parents=Names.of([sample.parent for sample in samples]),
        children=Names.of([sample.child for sample in samples]),
        stamp_ns=np.array([sample.stamp_ns for sample in samples], dtype=np.int64),
        values=np.array(values, dtype=np.float64).reshape(-1, 7),
    )


def from_messages(messages: Sequence[DetectionMessage]) -> DetectionColumns:
    """Columns of messages that were read one by one, at least one."""
    return DetectionColumns(
        stamp_ns=np.array([message.stamp_ns for message in messages], dtype=np.int64),
        frame_ids=Names.of([message.frame_id for message in messages]),
        box_counts=np.array([len(message.boxes) for message in messages], dtype=np.int64),
        boxes=np.concatenate([message.boxes for message in messages]),
        scores=np.concatenate([message.scores for message in messages]),
        class_names=Names.of([name for message in messages for name in message.class_names]),
        foreign=sum(message.foreign for message in messages),
        unsure_yaws=sum(message.unsure_yaws for message in messages),
    )
