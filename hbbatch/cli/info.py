"""`hbbatch info`: what logs and folders hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from hbbatch.cli.ingest_options import (
    ClassesOption,
    DetectionsOption,
    DistroOption,
    MappingOption,
    MaxGapOption,
    MessagePathOption,
    PoseTopicOption,
    SourceArgument,
    TopicOption,
    WorldFrameOption,
    source_options,
)
from hbbatch.cli.options import JsonOption

if TYPE_CHECKING:
    from hbbatch.sources.base import Description


def info(
    source: SourceArgument,
    detections: DetectionsOption = None,
    topic: TopicOption = None,
    world_frame: WorldFrameOption = None,
    pose_topic: PoseTopicOption = None,
    max_gap_s: MaxGapOption = None,
    mapping: MappingOption = None,
    msg_path: MessagePathOption = None,
    ros_distro: DistroOption = None,
    classes: ClassesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say what logs and folders hold, and what `ingest` would do with them."""
    from hbbatch.cli.output import complain, print_json
    from hbbatch.runner.info import describe_sources

    options = source_options(
        detections,
        topic,
        world_frame,
        pose_topic,
        max_gap_s,
        mapping,
        msg_path,
        ros_distro,
        classes,
    )
    report = describe_sources(source, options)
    if as_json:
        print_json(report.to_json())
    else:
        for description in report.descriptions:
            _print_description(description)
    for error in report.errors:
        complain(f"error: {error}")
    raise typer.Exit(int(report.exit_status))


def _print_description(description: Description) -> None:
    from hbbatch.cli.output import print_summary

    findings = description.findings
    declared = findings.messages_expected
    of = "" if declared in (None, description.messages) else f" of {declared} declared"
    rate = "" if description.rate_hz is None else f", {description.rate_hz:.1f} Hz"
    lines = [
        ("format", " ".join(filter(None, (description.format_name, description.profile)))),
        ("messages", f"{description.messages}{of} in {description.duration_s:.1f} s{rate}"),
        ("frames", ", ".join(description.frames) or "no transforms"),
        ("ingest would", description.would),
        *(("problem", problem) for problem in findings.problems),
    ]
    print_summary(str(description.path), lines)
    _print_topics(description)


def _print_topics(description: Description) -> None:
    from rich.table import Table

    from hbbatch.cli.output import print_table

    if not description.topics:
        return
    table = Table("topic", "type", "encoding", box=None, pad_edge=False)
    table.add_column("messages", justify="right")
    table.add_column("Hz", justify="right")
    table.add_column("holds")
    for topic in description.topics:
        rate = "" if topic.rate_hz is None else f"{topic.rate_hz:.1f}"
        holds = (
            f"{topic.holds}, cannot be decoded: {topic.problem}" if topic.problem else topic.holds
        )
        cells = (topic.topic, topic.message_type, topic.encoding, str(topic.messages), rate, holds)
        table.add_row(*(_plain(cell) for cell in cells))
    print_table(table)
    typer.echo()


def _plain(text: str) -> str:
    """Text of a log as text, not as markup."""
    from rich.markup import escape

    return escape(text)
