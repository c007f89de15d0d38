"""One pass over a log: detections of one topic, all transforms and poses, and what was odd."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.errors import SourceError
from hbbatch.sources.base import Findings, flat_boxes
from hbbatch.sources.channels import Channel, RawMessage
from hbbatch.sources.decoding import UNDECODABLE, Decode, decoder
from hbbatch.sources.log_poses import PoseMessages
from hbbatch.sources.messages import (
    DETECTION_MESSAGES,
    POSE_MESSAGES,
    TRANSFORM_MESSAGES,
    DetectionMessage,
)
from hbbatch.sources.transforms import frame_name

_SCORE_WHEN_MISSING: Final = 1.0
_Read = TypeVar("_Read")


@dataclass(frozen=True)
class Detected:
    """The usable boxes of a detection message, and the times it was recorded with.

    Attributes:
        timestamp_ns: header stamp, or the log time where there is none.
        log_time_ns: when the recorder received it.
        number: which message of the topic it is, from 0.
        frame_id: frame of the boxes, without leading slash.
        boxes: `(n, 7)` in that frame.
        scores: `(n,)`.
        class_names: n names.
    """

    timestamp_ns: int
    log_time_ns: int
    number: int
    frame_id: str
    boxes: FloatArray
    scores: FloatArray
    class_names: list[str]


class LogScan:
    """What the messages of a log, given one by one, add up to."""

    def __init__(self, topic: str) -> None:
        self.detected: list[Detected] = []
        self.poses = PoseMessages()
        self._topic = topic
        self._decoders: dict[Channel, Decode | None] = {}
        self._channel_errors: list[str] = []
        self._undecodable: Counter[str] = Counter()
        self._messages = 0
        self._unusable: Counter[int] = Counter()
        self._unscored = 0
        self._unstamped = 0

    def wants(self, channel: Channel) -> bool:
        """Whether messages of a channel are needed."""
        kind = channel.message_type
        is_detection = kind in DETECTION_MESSAGES and channel.topic == self._topic
        return is_detection or kind in TRANSFORM_MESSAGES or kind in POSE_MESSAGES

    def take(self, raw: RawMessage) -> None:
        """Decode a message of a wanted channel and keep what it says."""
        topic, kind = raw.channel.topic, raw.channel.message_type
        if kind in DETECTION_MESSAGES:
            message = self._read(raw, DETECTION_MESSAGES[kind])
            if message is not None:
                self._take_detections(message, raw.log_time_ns)
            self._messages += 1
        elif kind in TRANSFORM_MESSAGES:
            for sample in self._read(raw, TRANSFORM_MESSAGES[kind]) or ():
                self.poses.add_transform(topic, sample, raw.log_time_ns)
        else:
            for sample in self._read(raw, POSE_MESSAGES[kind]) or ():
                self.poses.add_pose(topic, sample, raw.log_time_ns)

    def report(self, findings: Findings) -> None:
        """Write down what was lost and what was odd in the messages taken."""
        for error in self._channel_errors:
            findings.lost(error)
        for topic, count in sorted(self._undecodable.items()):
            findings.lost(f"topic {topic}: {count} messages left out, they cannot be decoded")
        if self._unusable:
            findings.lost(
                f"topic {self._topic}: {self._unusable.total()} boxes left out, first in message "
                f"{min(self._unusable)}: not a number, or a size that is not greater than zero"
            )
        if self._unscored:
            findings.note(f"topic {self._topic}: {self._unscored} boxes without score, taken as 1")
        if self._unstamped:
            findings.note(
                f"topic {self._topic}: {self._unstamped} messages without stamp, log time taken"
            )
        backwards = int((np.diff([d.timestamp_ns for d in self.detected]) < 0).sum())
        if backwards:
            findings.note(f"topic {self._topic}: stamps run backwards {backwards} times, sorted")

    def _take_detections(self, message: DetectionMessage, log_time_ns: int) -> None:
        self._unstamped += message.stamp_ns == 0
        unscored = np.isnan(message.scores)
        self._unscored += int(unscored.sum())
        scores = np.where(unscored, _SCORE_WHEN_MISSING, message.scores)
        usable = np.isfinite(message.boxes).all(1) & np.isfinite(scores)
        usable &= ~flat_boxes(message.boxes)
        if not usable.all():
            self._unusable[self._messages] += int((~usable).sum())
        self.detected.append(
            Detected(
                timestamp_ns=message.stamp_ns or log_time_ns,
                log_time_ns=log_time_ns,
                number=self._messages,
                frame_id=frame_name(message.frame_id),
                boxes=message.boxes[usable],
                scores=scores[usable],
                class_names=[
                    n for n, kept in zip(message.class_names, usable, strict=True) if kept
                ],
            )
        )

    def _read(self, raw: RawMessage, read: Callable[[Any], _Read]) -> _Read | None:
        """What a message says; None, and counted, when it cannot be decoded."""
        channel = raw.channel
        if channel not in self._decoders:
            self._decoders[channel] = self._decoder(channel)
        decode = self._decoders[channel]
        if decode is None:
            return None
        try:
            return read(decode(raw.data))
        except UNDECODABLE:
            self._undecodable[channel.topic] += 1
            return None

    def _decoder(self, channel: Channel) -> Decode | None:
        try:
            return decoder(channel)
        except SourceError as error:
            self._channel_errors.append(str(error))
            return None
