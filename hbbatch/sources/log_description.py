"""What a log holds, told from reading all of it: topics, counts, rates and frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hbbatch.errors import SourceError
from hbbatch.sources.base import (
    Description,
    Findings,
    IntArray,
    SourceOptions,
    TopicDescription,
)
from hbbatch.sources.blocks import MessageLog
from hbbatch.sources.channels import Channel
from hbbatch.sources.decoding import decoder
from hbbatch.sources.log_scan import LogScan
from hbbatch.sources.mapping import detection_messages
from hbbatch.sources.messages import POSE_MESSAGES, SATELLITE_MESSAGES, TRANSFORM_MESSAGES

_NO_TOPIC: Final = ""


@dataclass
class _Tally:
    """Messages of a channel and the log times they lie between."""

    messages: int = 0
    first_ns: int = 0
    last_ns: int = 0

    def add(self, log_time_ns: IntArray) -> None:
        first = int(log_time_ns.min())
        self.first_ns = min(self.first_ns, first) if self.messages else first
        self.last_ns = max(self.last_ns, int(log_time_ns.max()))
        self.messages += len(log_time_ns)


def describe(log: MessageLog, options: SourceOptions) -> tuple[Description, list[Channel]]:
    """Everything but what ingest would do with it, and its channels."""
    findings = Findings()
    scan = LogScan(_NO_TOPIC, detection_messages(options.mappings), options)
    tallies = {channel: _Tally() for channel in log.channels(Findings())}
    for block in log.blocks(lambda _: True, findings):
        for code in np.unique(block.codes).tolist():
            tally = tallies.setdefault(block.channels[code], _Tally())
            tally.add(block.log_time_ns[block.codes == code])
        scan.take(block)
    scan.finish(findings)
    met = [tally for tally in tallies.values() if tally.messages]
    description = Description(
        path=log.path,
        format_name=log.format_name,
        profile=log.profile(),
        start_ns=min((tally.first_ns for tally in met), default=None),
        end_ns=max((tally.last_ns for tally in met), default=None),
        messages=sum(tally.messages for tally in met),
        topics=_topics(tallies, options),
        frames=[f"{child} < {parent}" for child, parent in scan.poses.tree.edges()],
        would="",
        findings=findings,
    )
    return description, list(tallies)


def _topics(tallies: dict[Channel, _Tally], options: SourceOptions) -> Sequence[TopicDescription]:
    """A topic and type each; several writers of one count together."""
    joined: dict[tuple[str, str], list[Channel]] = {}
    for channel in tallies:
        joined.setdefault((channel.topic, channel.message_type), []).append(channel)
    return [_topic([(c, tallies[c]) for c in same], options) for _, same in sorted(joined.items())]


def _topic(parts: Sequence[tuple[Channel, _Tally]], options: SourceOptions) -> TopicDescription:
    channel = parts[0][0]
    met = [tally for _, tally in parts if tally.messages]
    count = sum(tally.messages for tally in met)
    span_ns = max((t.last_ns for t in met), default=0) - min((t.first_ns for t in met), default=0)
    holds = _holds(channel.message_type, options)
    return TopicDescription(
        topic=channel.topic,
        message_type=channel.message_type,
        encoding="/".join(filter(None, (channel.message_encoding, channel.schema_encoding))),
        messages=count,
        rate_hz=(count - 1) * 1e9 / span_ns if count > 1 and span_ns > 0 else None,
        holds=holds,
        problem=_problem(channel, options) if holds else "",
    )


def _holds(kind: str, options: SourceOptions) -> str:
    if kind in detection_messages(options.mappings):
        return "detections"
    if kind in TRANSFORM_MESSAGES:
        return "transforms"
    return "poses" if kind in POSE_MESSAGES or kind in SATELLITE_MESSAGES else ""


def _problem(channel: Channel, options: SourceOptions) -> str:
    try:
        decoder(channel, options)
    except SourceError as error:
        return str(error)
    return ""
