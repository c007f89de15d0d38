"""One pass over a log: detections of one topic, all transforms and poses, and what was odd."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from hbbatch.sources.base import Findings, SourceOptions
from hbbatch.sources.batched import (
    ChannelReader,
    detection_reader,
    satellite_reader,
    transform_reader,
)
from hbbatch.sources.channels import Channel, RawMessage
from hbbatch.sources.detection_store import DetectionStore
from hbbatch.sources.log_poses import PoseMessages
from hbbatch.sources.messages import (
    POSE_MESSAGES,
    SATELLITE_MESSAGES,
    TRANSFORM_MESSAGES,
    ReadDetections,
)


class LogScan:
    """What the messages of a log, given one by one, add up to."""

    def __init__(
        self, topic: str, detections: dict[str, ReadDetections], options: SourceOptions
    ) -> None:
        self.store = DetectionStore(topic)
        self.poses = PoseMessages(options)
        self._topic, self._detections, self._options = topic, detections, options
        self._readers: dict[Channel, ChannelReader[Any, Any]] = {}
        self._latest: dict[int, ChannelReader[Any, Any]] = {}
        self._numbers: Counter[str] = Counter()

    def wants(self, channel: Channel) -> bool:
        """Whether messages of a channel are needed."""
        kind = channel.message_type
        if kind in self._detections:
            return channel.topic == self._topic
        return kind in TRANSFORM_MESSAGES or kind in POSE_MESSAGES or kind in SATELLITE_MESSAGES

    def take(self, message: RawMessage) -> None:
        """Keep what a message of a wanted channel says; it may be read only later."""
        channel = message.channel
        # Found by identity first: comparing channels costs more than taking a message.
        reader = self._latest.get(id(channel))
        if reader is None or reader.channel is not channel:
            reader = self._readers.get(channel)
            if reader is None:
                reader = self._readers[channel] = self._reader(channel)
            self._latest[id(channel)] = reader
        number = self._numbers[channel.topic]
        self._numbers[channel.topic] += 1
        if reader.add(number, message):
            self._flush(reader)

    def finish(self, findings: Findings) -> None:
        """Read what is left, and write down what was lost and what was odd."""
        for reader in self._readers.values():
            self._flush(reader)
            self._report(reader, findings)
        self.store.report(findings)
        self.poses.report(findings)

    @staticmethod
    def _report(reader: ChannelReader[Any, Any], findings: Findings) -> None:
        if reader.problem:
            findings.lost(reader.problem)
        if reader.note:
            findings.note(reader.note)
        if reader.undecodable:
            findings.lost(
                f"topic {reader.channel.topic}: {reader.undecodable} messages left out, they "
                "cannot be decoded"
            )

    def _reader(self, channel: Channel) -> ChannelReader[Any, Any]:
        kind = channel.message_type
        if kind in self._detections:
            return detection_reader(channel, self._detections[kind], self._options)
        if kind in SATELLITE_MESSAGES:
            return satellite_reader(channel, SATELLITE_MESSAGES[kind], self._options)
        read = TRANSFORM_MESSAGES.get(kind) or POSE_MESSAGES[kind]
        return transform_reader(channel, read, self._options)

    def _flush(self, reader: ChannelReader[Any, Any]) -> None:
        flushed = reader.flush()
        if flushed is None:
            return
        said, entries = flushed
        topic, kind = reader.channel.topic, reader.channel.message_type
        log_time_ns = np.array([m.log_time_ns for _, m in entries], dtype=np.int64)
        if kind in self._detections:
            numbers = np.array([number for number, _ in entries], dtype=np.int64)
            self.store.add(said, numbers, log_time_ns)
        elif kind in SATELLITE_MESSAGES:
            for part, time_ns in zip(said, log_time_ns.tolist(), strict=True):
                self.poses.add_satellite(topic, part, time_ns)
        elif kind in TRANSFORM_MESSAGES:
            self.poses.add_transforms(topic, said, log_time_ns)
        else:
            self.poses.add_poses(topic, kind, said, log_time_ns)
