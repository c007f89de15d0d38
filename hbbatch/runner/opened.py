"""Sources opened as `ingest` and `info` both do: each once, and no option that concerns none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

from hbbatch.errors import SourceError, UsageError, report_defect
from hbbatch.sources.base import Source, SourceOptions, source_errors
from hbbatch.sources.classes import load_taxonomy
from hbbatch.sources.decoding import check_definitions
from hbbatch.sources.detect import open_sources, told_apart
from hbbatch.sources.mapping import detection_messages

_Result = TypeVar("_Result")
_FLAGS: Final = {
    "detections": "--detections",
    "topics": "--topic",
    "world_frame": "--world-frame",
    "pose_topic": "--pose-topic",
    "max_gap_s": "--max-gap-s",
    "mappings": "--mapping",
    "message_paths": "--msg-path",
    "ros_distro": "--ros-distro",
}
"""Fields of `SourceOptions` that concern some formats only, and what the user calls them."""


@dataclass
class OpenedSources:
    """Sources, and why others could not be opened."""

    sources: list[Source] = field(default_factory=list)
    errors: list[SourceError] = field(default_factory=list)

    def ask(self, path: Path, question: Callable[[], _Result]) -> _Result | None:
        """The answer of one source; None, and an entry in the errors, when it fails in any way.

        Raises:
            UsageError: an option names a file or release that cannot be used.
        """
        try:
            with source_errors(path):
                return question()
        except UsageError:
            raise
        except SourceError as error:
            self.errors.append(error)
        except Exception as error:  # noqa: BLE001 - whatever is wrong with one must not stop others
            self.errors.append(SourceError(f"{path}: {report_defect(error)}"))
        return None


def open_all(paths: Sequence[Path], options: SourceOptions) -> OpenedSources:
    """All sources at and below some paths; one that is there twice is read once.

    Logs of the same name in different folders are told apart by the names of the folders.

    Raises:
        UsageError: an option names a file or release that cannot be used, or is given and concerns
            none of them.
    """
    load_taxonomy(options.classes)
    detection_messages(options.mappings)
    check_definitions(options)
    opened = OpenedSources()
    once: dict[Path, Source] = {}
    for path in paths:
        for source in opened.ask(path, partial(open_sources, path, options)) or ():
            # A link that leads in circles has no end to be known by.
            known_by = source.path.resolve() if source.path.exists() else source.path
            once.setdefault(known_by, source)
    opened.sources += told_apart(once.values())
    if not opened.errors and opened.sources:
        _refuse_idle(opened.sources, options)
    return opened


def _refuse_idle(sources: Sequence[Source], options: SourceOptions) -> None:
    """Raise a UsageError for an option that has been given and concerns none of the sources."""
    given = {name for name in _FLAGS if getattr(options, name) != getattr(SourceOptions(), name)}
    idle = given.difference(*(source.uses for source in sources))
    if idle:
        flags = ", ".join(_FLAGS[name] for name in sorted(idle))
        formats = ", ".join(sorted({source.format_name for source in sources}))
        raise UsageError(
            f"{flags}: of no use to these sources ({formats}: {sources[0].path}"
            f"{', …' if len(sources) > 1 else ''}). Leave it out, or check the path."
        )
