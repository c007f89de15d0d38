"""Recorded logs, whatever the container: which topic holds detections, and its frames with poses.

A log is read once. Detections and transforms are decoded in batches as they come and everything
else is left as bytes; frames are then put in the order of their header stamps (equal stamps keep
the order of the file) and given poses, since transforms often arrive after the data they explain.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.dataset.store import safe_name
from hbbatch.errors import SourceChoiceError, SourceError
from hbbatch.sources import gaps
from hbbatch.sources.base import (
    POSE_ORIGINS,
    Description,
    Findings,
    IntArray,
    Names,
    Poses,
    SequenceReading,
    SourceOptions,
)
from hbbatch.sources.blocks import MessageLog
from hbbatch.sources.channels import Channel
from hbbatch.sources.detection_store import DetectionStore
from hbbatch.sources.log_description import describe
from hbbatch.sources.log_poses import PoseMessages
from hbbatch.sources.log_scan import LogScan
from hbbatch.sources.mapping import detection_messages, mapping_hashes
from hbbatch.sources.messages import SHOWN_MESSAGES
from hbbatch.sources.rosbag2 import log_stem
from hbbatch.sources.transforms import EXTRAPOLATION_NS

_LISTED_TOPICS: Final = 20
_LISTED_SEQUENCES: Final = 4
_USES: Final = (
    "topics",
    "world_frame",
    "pose_topic",
    "max_gap_s",
    "mappings",
    "message_paths",
    "ros_distro",
)


@dataclass(frozen=True)
class LogSource:
    """A log; each detection topic asked for is a sequence, named `name` or else as the file is."""

    log: MessageLog
    options: SourceOptions
    name: str | None = None

    @property
    def path(self) -> Path:
        """The file or folder."""
        return self.log.path

    @property
    def format_name(self) -> str:
        """Name of the container format."""
        return self.log.format_name

    @property
    def uses(self) -> Sequence[str]:
        """All that is said about logs."""
        return _USES

    @property
    def stem(self) -> str:
        """What its sequences are named after."""
        return safe_name(self.name or log_stem(self.path))

    def sequences(self) -> Sequence[LogSequence]:
        """A sequence for the only detection topic, or one for each topic asked for.

        Raises:
            SourceChoiceError: there is no such topic, or several and none was asked for.
            SourceError: no topic holds detections.
        """
        findings = Findings()
        return self._sequences(self.log.channels(findings), findings)

    def describe(self) -> Description:
        """What the log holds, and what ingest would make of it; all of it is read."""
        description, channels = describe(self.log, self.options)
        try:
            sequences = self._sequences(channels, description.findings)
        except SourceError as error:
            return replace(description, would=f"refuse: {error}")
        would = [sequence.would(description.findings) for sequence in sequences]
        return replace(description, would="; ".join(would))

    def _sequences(self, channels: Sequence[Channel], findings: Findings) -> list[LogSequence]:
        topics = self._chosen(channels, findings)
        if len(topics) == 1:
            return [LogSequence(self.log, topics[0], self.stem, self.options)]
        return [
            LogSequence(self.log, topic, safe_name(f"{self.stem}-{topic.strip('/')}"), self.options)
            for topic in topics
        ]

    def _chosen(self, channels: Sequence[Channel], findings: Findings) -> Sequence[str]:
        offered = _offered(channels, self.options)
        listed = ", ".join(offered)
        if not offered:
            raise SourceError(
                f"{self.path}: no detections in it. It holds {_listing(channels)}."
                f"{_damage(findings)}"
            )
        missing = sorted(set(self.options.topics) - set(offered))
        if missing:
            raise SourceChoiceError(
                f"{self.path}: no detections on {', '.join(missing)}. Choose from {listed}."
            )
        if len(offered) > 1 and not self.options.topics:
            raise SourceChoiceError(
                f"{self.path}: several detection topics ({listed}). Use --topic."
            )
        return list(dict.fromkeys(self.options.topics)) or offered


def _offered(channels: Sequence[Channel], options: SourceOptions) -> list[str]:
    """Detection topics; those that are made to be looked at where there is no other, or chosen."""
    known = detection_messages(options.mappings)
    held = {c.topic: c.message_type for c in channels if c.message_type in known}
    measured = {t for t, kind in held.items() if kind not in SHOWN_MESSAGES}
    return sorted(measured | (set(options.topics) & set(held)) or held)


def _listing(channels: Sequence[Channel]) -> str:
    topics = sorted({f"{c.topic} ({c.message_type or 'no type'})" for c in channels})
    more = len(topics) - _LISTED_TOPICS
    listed = topics[:_LISTED_TOPICS] + ([f"and {more} more"] if more > 0 else [])
    return ", ".join(listed) or "no topics"


def _damage(findings: Findings) -> str:
    """What was lost of the file, a sentence to put behind an error that may come from it."""
    return f" Damage: {_joined(findings.problems)}." if findings.partial else ""


def _joined(problems: Sequence[str]) -> str:
    return "; ".join(problem.removesuffix(".") for problem in problems)


@dataclass(frozen=True)
class LogSequence:
    """The detections of one topic of a log."""

    log: MessageLog
    topic: str
    sequence_id: str
    options: SourceOptions

    def fingerprint(self) -> str:
        """Hash of the log, the topic and the options that concern it."""
        concerned = (
            self.topic,
            self.options.world_frame,
            self.options.pose_topic,
            self.options.max_gap_s,
            self.options.ros_distro,
            [str(path) for path in self.options.message_paths],
            mapping_hashes(self.options.mappings),
        )
        return hashlib.sha256(f"{self.log.fingerprint()} {concerned!r}".encode()).hexdigest()

    def would(self, findings: Findings) -> str:
        """What ingest would do, found by reading; problems that are new go to the findings."""
        try:
            readings = self.read()
        except SourceError as error:
            return f"fail: {error}"
        for reading in readings:
            findings.partial |= reading.findings.partial
            findings.problems += [
                problem for problem in reading.findings.problems if problem not in findings.problems
            ]
        return f"ingest {self.topic} as {_named(readings)}"

    def read(self) -> list[SequenceReading]:
        """Read the log; the findings are complete at once."""
        findings = Findings()
        scan = LogScan(self.topic, detection_messages(self.options.mappings), self.options)
        for block in self.log.blocks(scan.wants, findings):
            scan.take(block)
        scan.finish(findings)
        if not len(scan.store):
            why = _joined(findings.problems) or "there is none"
            raise SourceError(f"{self.log.path}: no message on {self.topic} can be read: {why}.")
        order, stamps_ns = scan.store.order()
        frames = scan.store.frame_ids(order)
        try:
            poses, known = _frame_poses(frames, stamps_ns, scan.poses, findings)
        except SourceError as error:
            raise SourceError(
                f"{self.log.path}: topic {self.topic}: {error}{_damage(findings)}"
            ) from error
        rows = np.flatnonzero(known)
        kept = _Kept(order[rows], stamps_ns[rows], frames[rows], poses[rows])
        return self._readings(scan.store, kept, findings)

    def _readings(
        self, store: DetectionStore, kept: _Kept, findings: Findings
    ) -> list[SequenceReading]:
        parts = gaps.parts(kept.stamps_ns, self.options.max_gap_s)
        if len(parts) > 1:
            findings.note(f"topic {self.topic}: {len(parts)} sequences, it pauses between them")
        digits = len(str(len(parts) - 1))
        names = [f"{self.sequence_id}-{number:0{max(digits, 3)}d}" for number in range(len(parts))]
        if len(parts) == 1:
            names = [self.sequence_id]
        return [
            SequenceReading(
                name,
                store.batches(
                    kept.order[part],
                    kept.frames[part],
                    kept.poses[part],
                ),
                None,
                None,
                replace(findings, problems=list(findings.problems)),
            )
            for name, part in zip(names, parts, strict=True)
        ]


def _named(readings: Sequence[SequenceReading]) -> str:
    """Names of sequences, of many the first and last."""
    names = [reading.sequence_id for reading in readings]
    if len(names) <= _LISTED_SEQUENCES:
        return ", ".join(names)
    return f"{names[0]} to {names[-1]}, {len(names)} sequences"


@dataclass(frozen=True)
class _Kept:
    """The frames of a topic that have a pose, in time order."""

    order: IntArray
    stamps_ns: IntArray
    frames: Names
    poses: Poses


def _frame_poses(
    frames: Names, stamps_ns: IntArray, messages: PoseMessages, findings: Findings
) -> tuple[Poses, NDArray[np.bool_]]:
    """The pose of each message's sensor at its stamp; a topic may mix frames."""
    poses = Poses.identity(len(stamps_ns))
    known = np.zeros(len(stamps_ns), dtype=bool)
    translation_m, rotation = poses.translation_m, poses.rotation
    origins = np.zeros(len(stamps_ns), dtype=np.int64)
    for code in sorted(set(frames.codes.tolist()), key=lambda c: frames.vocabulary[c]):
        rows = np.flatnonzero(frames.codes == code)
        found = messages.resolve(frames.vocabulary[code], stamps_ns[rows], findings)
        translation_m[rows], rotation[rows] = found.poses.translation_m, found.poses.rotation
        known[rows] = found.known
        kinds = [POSE_ORIGINS.index(origin) for origin in found.poses.origins.vocabulary]
        origins[rows] = np.array(kinds)[found.poses.origins.codes]
    unknown = int((~known).sum())
    if unknown:
        findings.lost(
            f"{unknown} frames left out: no pose of the sensor within {EXTRAPOLATION_NS / 1e9} s"
        )
    return Poses(translation_m, rotation, Names(origins, POSE_ORIGINS)), known
