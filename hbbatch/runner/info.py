"""What sources hold and what ingest would do with them; nothing is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from hbbatch.errors import ExitStatus, SourceError, status_of
from hbbatch.runner.opened import open_all
from hbbatch.sources.base import Description, SourceOptions


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
        UsageError: an option names a file or release that cannot be used, or is of no use.
    """
    opened = open_all(paths, options)
    described = [opened.ask(source.path, source.describe) for source in opened.sources]
    return InfoReport([d for d in described if d is not None], opened.errors)


def _plain(description: Description) -> dict[str, Any]:
    findings = description.findings
    return {
        "path": str(description.path),
        "format": description.format_name,
        "profile": description.profile,
        "start_ns": description.start_ns,
        "end_ns": description.end_ns,
        "duration_s": description.duration_s,
        "rate_hz": description.rate_hz,
        "messages": description.messages,
        "messages_expected": findings.messages_expected,
        "topics": [asdict(topic) for topic in description.topics],
        "frames": list(description.frames),
        "ingest_would": description.would,
        "partial": findings.partial,
        "problems": findings.problems,
    }
