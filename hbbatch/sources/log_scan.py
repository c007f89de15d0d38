"""One pass over a log: detections of one topic, all transforms and poses, and what was odd."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from hbbatch.sources.base import Findings, IntArray, Names, SourceOptions
from hbbatch.sources.batched import (
    ChannelReader,
    detection_reader,
    satellite_reader,
    transform_reader,
)
from hbbatch.sources.blocks import Block
from hbbatch.sources.channels import Channel
from hbbatch.sources.detection_store import DetectionStore
from hbbatch.sources.log_poses import PoseMessages
from hbbatch.sources.messages import (
    POSE_MESSAGES,
    SATELLITE_MESSAGES,
    TRANSFORM_MESSAGES,
    ReadDetections,
)


class LogScan:
    """What the messages of a log, given block by block, add up to."""

    def __init__(
        self, topic: str, detections: dict[str, ReadDetections], options: SourceOptions
    ) -> None:
        self.store = DetectionStore(topic)
        self.poses = PoseMessages(options)
        self._topic, self._detections, self._options = topic, detections, options
        self._readers: dict[Channel, ChannelReader[Any, Any]] = {}
        self._numbers: Counter[str] = Counter()

    def wants(self, channel: Channel) -> bool:
        """Whether messages of a channel are needed."""
        kind = channel.message_type
        if kind in self._detections:
            return channel.topic == self._topic
        return kind in TRANSFORM_MESSAGES or kind in POSE_MESSAGES or kind in SATELLITE_MESSAGES

    def take(self, block: Block) -> None:
        """Keep what the messages of wanted channels say."""
        numbers = self._numbered(block)
        for code in np.unique(block.codes).tolist():
            channel = block.channels[code]
            if not self.wants(channel):
                continue
            if channel not in self._readers:
                self._readers[channel] = self._reader(channel)
            rows = np.flatnonzero(block.codes == code)
            self._read(self._readers[channel], block, rows, numbers[rows])

    def _numbered(self, block: Block) -> IntArray:
        """Which message of its topic each message is, from 0."""
        topics = Names.of([channel.topic for channel in block.channels])
        of_message = topics.codes[block.codes]
        numbers = np.zeros(len(of_message), dtype=np.int64)
        for code, topic in enumerate(topics.vocabulary):
            rows = np.flatnonzero(of_message == code)
            numbers[rows] = self._numbers[topic] + np.arange(len(rows))
            self._numbers[topic] += len(rows)
        return numbers

    def finish(self, findings: Findings) -> None:
        """Write down what was lost and what was odd."""
        for reader in self._readers.values():
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
                f"cannot be decoded ({reader.reason})"
            )

    def _reader(self, channel: Channel) -> ChannelReader[Any, Any]:
        kind = channel.message_type
        if kind in self._detections:
            return detection_reader(channel, self._detections[kind], self._options)
        if kind in SATELLITE_MESSAGES:
            return satellite_reader(channel, SATELLITE_MESSAGES[kind], self._options)
        read = TRANSFORM_MESSAGES.get(kind) or POSE_MESSAGES[kind]
        return transform_reader(channel, read, self._options)

    def _read(
        self, reader: ChannelReader[Any, Any], block: Block, rows: IntArray, numbers: IntArray
    ) -> None:
        read = reader.read(block.payloads[rows])
        if read is None:
            return
        said, kept = read
        topic, kind = reader.channel.topic, reader.channel.message_type
        log_time_ns = block.log_time_ns[rows[kept]]
        if kind in self._detections:
            self.store.add(said, numbers[kept], log_time_ns)
        elif kind in SATELLITE_MESSAGES:
            for part, time_ns in zip(said, log_time_ns.tolist(), strict=True):
                self.poses.add_satellite(topic, part, time_ns)
        elif kind in TRANSFORM_MESSAGES:
            self.poses.add_transforms(topic, said, log_time_ns)
        else:
            self.poses.add_poses(topic, kind, said, log_time_ns)
