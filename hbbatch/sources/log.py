"""Recorded logs, whatever the container: which topic holds detections, and its frames with poses.

A log is read once. Detections and transforms are decoded as they come and everything else is left
as bytes; frames are then put in the order of their header stamps (equal stamps keep the order of
the file) and given poses, since transforms often arrive after the data they explain.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from hbbatch.dataset.store import safe_name
from hbbatch.errors import SourceError
from hbbatch.sources.base import (
    Findings,
    Frame,
    Pose,
    SequenceReading,
    SourceOptions,
    no_image_boxes,
)
from hbbatch.sources.channels import Channel, MessageLog
from hbbatch.sources.log_poses import PoseMessages
from hbbatch.sources.log_scan import Detected, LogScan
from hbbatch.sources.messages import DETECTION_MESSAGES
from hbbatch.sources.transforms import EXTRAPOLATION_NS

_LISTED_TOPICS: Final = 20


@dataclass(frozen=True)
class LogSource:
    """A log; each detection topic asked for is a sequence."""

    log: MessageLog
    options: SourceOptions

    @property
    def path(self) -> Path:
        """The file."""
        return self.log.path

    @property
    def format_name(self) -> str:
        """Name of the container format."""
        return self.log.format_name

    def sequences(self) -> Sequence[LogSequence]:
        """A sequence for the only detection topic, or one for each topic asked for.

        Raises:
            SourceError: there is no such topic, or several and none was asked for.
        """
        topics = self._topics()
        stem = safe_name(self.path.stem)
        if len(topics) == 1:
            return [LogSequence(self.log, topics[0], stem)]
        return [
            LogSequence(self.log, topic, safe_name(f"{stem}-{topic.strip('/')}"))
            for topic in topics
        ]

    def _topics(self) -> Sequence[str]:
        findings = Findings()
        channels = self.log.channels(findings)
        offered = sorted({c.topic for c in channels if c.message_type in DETECTION_MESSAGES})
        listed = ", ".join(offered)
        if not offered:
            raise SourceError(
                f"{self.path}: no detections in it. It holds {_listing(channels)}."
                f"{_damage(findings)}"
            )
        missing = sorted(set(self.options.topics) - set(offered))
        if missing:
            raise SourceError(
                f"{self.path}: no detections on {', '.join(missing)}. Choose from {listed}."
            )
        if len(offered) > 1 and not self.options.topics:
            raise SourceError(f"{self.path}: several detection topics ({listed}). Use --topic.")
        return self.options.topics or offered


def _listing(channels: Sequence[Channel]) -> str:
    topics = sorted({f"{c.topic} ({c.message_type or 'no type'})" for c in channels})
    more = len(topics) - _LISTED_TOPICS
    listed = topics[:_LISTED_TOPICS] + ([f"and {more} more"] if more > 0 else [])
    return ", ".join(listed) or "no topics"


def _damage(findings: Findings) -> str:
    """What was lost of the file, a sentence to put behind an error that may come from it."""
    return f" Damage: {'; '.join(findings.problems)}." if findings.partial else ""


@dataclass(frozen=True)
class LogSequence:
    """The detections of one topic of a log."""

    log: MessageLog
    topic: str
    sequence_id: str

    def fingerprint(self) -> str:
        """Hash of the log and the topic."""
        return hashlib.sha256(f"{self.log.fingerprint()} {self.topic}".encode()).hexdigest()

    def read(self) -> SequenceReading:
        """Read the log; the findings are complete at once."""
        findings = Findings()
        scan = LogScan(self.topic)
        for message in self.log.messages(scan.wants, findings):
            scan.take(message)
        scan.report(findings)
        scan.poses.report(findings)
        if not scan.detected:
            raise SourceError(
                f"{self.log.path}: no message on {self.topic} can be read.{_damage(findings)} "
                "Check the recording."
            )
        detected = sorted(scan.detected, key=lambda message: message.timestamp_ns)
        try:
            poses = _frame_poses(detected, scan.poses, findings)
        except SourceError as error:
            raise SourceError(
                f"{self.log.path}: topic {self.topic}: {error}{_damage(findings)}"
            ) from error
        return SequenceReading(_frames(detected, poses), None, None, findings)


def _frame_poses(
    detected: Sequence[Detected], messages: PoseMessages, findings: Findings
) -> list[Pose | None]:
    """The pose of each message's sensor at its stamp; a topic may mix frames."""
    poses: list[Pose | None] = [None] * len(detected)
    for frame in sorted({message.frame_id for message in detected}):
        rows = [row for row, message in enumerate(detected) if message.frame_id == frame]
        stamps_ns = np.array([detected[row].timestamp_ns for row in rows])
        for row, pose in zip(rows, messages.resolve(frame, stamps_ns, findings), strict=True):
            poses[row] = pose
    unknown = poses.count(None)
    if unknown:
        findings.lost(
            f"{unknown} frames left out: no pose of the sensor within {EXTRAPOLATION_NS / 1e9} s"
        )
    return poses


def _frames(detected: Sequence[Detected], poses: Sequence[Pose | None]) -> Iterator[Frame]:
    for message, pose in zip(detected, poses, strict=True):
        if pose is not None:
            count = len(message.boxes)
            yield Frame(
                timestamp_ns=message.timestamp_ns,
                log_time_ns=message.log_time_ns,
                frame_id=message.frame_id,
                pose=pose,
                boxes=message.boxes,
                scores=message.scores,
                class_names=message.class_names,
                image_boxes=no_image_boxes(count),
                source_rows=np.full(count, message.number),
            )
