"""What sources hold and what ingest would do with them; nothing is written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from hbbatch.errors import ExitStatus, SourceError, status_of
from hbbatch.sources.base import Description, Source, SourceOptions, source_errors
from hbbatch.sources.detect import open_sources


@dataclass
class InfoReport:
    """Descriptions of sources.

    Attributes:
        descriptions: one a source that could be opened.
        errors: why others could not.
    """

    descriptions: list[Description] = field(default_factory=list)
    errors: list[SourceError] = field(default_factory=list)

    @property
    def exit_status(self) -> ExitStatus:
        """What the process tells the shell."""
        if self.errors:
            return status_of(self.errors)
        partial = any(description.findings.partial for description in self.descriptions)
        return ExitStatus.DATA_LOSS if partial else ExitStatus.DONE

    def to_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return {
            "sources": [_plain(d) for d in self.descriptions],
            "errors": list(map(str, self.errors)),
        }


def describe_sources(paths: Sequence[Path], options: SourceOptions) -> InfoReport:
    """Describe logs and folders, walked as ingest does.

    Raises:
        UsageError: an option names a file or release that cannot be used.
    """
    report = InfoReport()
    for source in _opened(paths, options, report):
        try:
            with source_errors(source.path):
                report.descriptions.append(source.describe())
        except SourceError as error:
            report.errors.append(error)
    return report


def _opened(paths: Sequence[Path], options: SourceOptions, report: InfoReport) -> Iterator[Source]:
    for path in paths:
        try:
            yield from open_sources(path, options)
        except SourceError as error:
            report.errors.append(error)


def _plain(description: Description) -> dict[str, Any]:
    findings = description.findings
    return {
        "path": str(description.path),
        "format": description.format_name,
        "profile": description.profile,
        "start_ns": description.start_ns,
        "end_ns": description.end_ns,
        "duration_s": description.duration_s,
        "messages": description.messages,
        "messages_expected": findings.messages_expected,
        "topics": [asdict(topic) for topic in description.topics],
        "frames": list(description.frames),
        "ingest_would": description.would,
        "partial": findings.partial,
        "problems": findings.problems,
    }
