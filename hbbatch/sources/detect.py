"""Which format a path holds, found from its content; formats are added here."""

from __future__ import annotations

import os
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Final

from hbbatch.dataset.store import safe_name
from hbbatch.errors import SourceChoiceError, SourceError
from hbbatch.sources.bag import BagLog, is_bag_file
from hbbatch.sources.base import (
    Description,
    SequenceHandle,
    Source,
    SourceOptions,
    source_errors,
)
from hbbatch.sources.kitti import KittiSource, is_kitti_folder
from hbbatch.sources.kitti_raw import KittiRawSource, is_kitti_raw_drive
from hbbatch.sources.log import LogSource
from hbbatch.sources.mcap import McapLog, is_mcap_file
from hbbatch.sources.rosbag2 import (
    PackedLog,
    Rosbag2Log,
    is_packed_log,
    is_rosbag2_folder,
    log_stem,
)
from hbbatch.sources.sqlite import Db3Log, is_db3_file


@dataclass(frozen=True)
class Format:
    """A format that can be read.

    Attributes:
        description: how to name it when listing what would have been understood.
        recognises: whether a path holds it, told from its content.
        open: the source at such a path; nothing is read yet.
    """

    description: str
    recognises: Callable[[Path], bool]
    open: Callable[[Path, SourceOptions], Source]


FORMATS: Final = (
    Format(
        "a KITTI raw drive (oxts/data, oxts/timestamps.txt)",
        is_kitti_raw_drive,
        KittiRawSource,
    ),
    Format(
        "a KITTI tracking folder (calib, oxts, label_02)",
        is_kitti_folder,
        KittiSource,
    ),
    Format(
        "a ROS 2 bag folder (metadata.yaml with .db3 or .mcap files)",
        is_rosbag2_folder,
        lambda path, options: LogSource(Rosbag2Log(path), options),
    ),
    Format(
        "an MCAP file",
        is_mcap_file,
        lambda path, options: LogSource(McapLog(path), options),
    ),
    Format(
        "a ROS 1 bag",
        is_bag_file,
        lambda path, options: LogSource(BagLog(path), options),
    ),
    Format(
        "a .db3 file",
        is_db3_file,
        lambda path, options: LogSource(Db3Log(path), options),
    ),
    Format(
        "a .db3.zstd or .mcap.zstd file",
        is_packed_log,
        lambda path, options: LogSource(PackedLog(path), options),
    ),
)


_LOG_SUFFIXES: Final = (".mcap", ".bag", ".db3")
_PACKED_SUFFIXES: Final = ("", ".zstd", ".zst")


@dataclass(frozen=True)
class UnreadableLog:
    """A file that its name calls a log and that no format recognises, or that cannot be opened.

    It is a source so that it is reported like any other that fails, and stops none of them.
    """

    path: Path
    error: SourceError
    format_name: str = ""

    @property
    def uses(self) -> Sequence[str]:
        """Nobody knows: no option is of no use to it."""
        return [option.name for option in fields(SourceOptions)]

    def sequences(self) -> Sequence[SequenceHandle]:
        """Raises what is wrong with the file."""
        raise self.error

    def describe(self) -> Description:
        """Raises what is wrong with the file."""
        raise self.error


def open_sources(path: Path, options: SourceOptions) -> list[Source]:
    """The source at a path, or all sources below it when it is a folder of logs.

    Logs of the same name in different folders below it are told apart by those folders' names.

    Raises:
        SourceChoiceError: it does not exist.
        SourceError: nothing there is understood.
    """
    if not path.exists():
        raise SourceChoiceError(f"{path}: does not exist. Check the path.")
    with source_errors(path):
        sources = list(_open_below(path, options))
    if not sources:
        raise _not_understood(path)
    return _told_apart_below(sources, path)


def told_apart(sources: Iterable[Source]) -> list[Source]:
    """Sources that were given side by side, logs of the same name named by their folders.

    The folders are those below the deepest one that all logs of that name are in.
    """
    named = list(sources)
    folders: defaultdict[str, list[Path]] = defaultdict(list)
    for source in named:
        if isinstance(source, LogSource):
            folders[source.stem].append(source.path.parent.resolve())
    roots = {stem: Path(os.path.commonpath(same)) for stem, same in folders.items()}
    return [
        _named_below(s, s.path.parent.resolve().relative_to(roots[s.stem]))
        if isinstance(s, LogSource) and len(folders[s.stem]) > 1
        else s
        for s in named
    ]


def _told_apart_below(sources: Sequence[Source], root: Path) -> list[Source]:
    """The sources, where logs of the same name are named by their path below the root."""
    counts = Counter(s.stem for s in sources if isinstance(s, LogSource))
    return [
        _named_below(s, s.path.relative_to(root).parent)
        if isinstance(s, LogSource) and counts[s.stem] > 1
        else s
        for s in sources
    ]


def _named_below(source: LogSource, folder: Path) -> LogSource:
    return replace(source, name="-".join([*folder.parts, safe_name(log_stem(source.path))]))


def _not_understood(path: Path) -> SourceError:
    known = "; ".join(known_format.description for known_format in FORMATS)
    return SourceError(f"{path}: {_nothing_in(path)}. Can be read: {known}.")


def _no_file(path: Path) -> SourceError:
    what = "a link to nothing" if path.is_symlink() else "no file"
    return SourceError(f"{path}: {what}. Check where it should be, or remove it.")


def _nothing_in(path: Path) -> str:
    if path.is_file():
        return "an unknown format" if path.stat().st_size else "an empty file"
    return "a folder with nothing in it that is known" if any(path.iterdir()) else "an empty folder"


def _open_below(path: Path, options: SourceOptions) -> Iterator[Source]:
    try:
        chosen = next((f for f in FORMATS if f.recognises(path)), None)
        entries = _visible(path) if chosen is None and path.is_dir() else ()
    except OSError as error:
        reason = f"cannot be read ({error.strerror or error}). Check that it is there and readable"
        yield UnreadableLog(path, SourceError(f"{path}: {reason}."))
        return
    if chosen is not None:
        yield chosen.open(path, options)
    elif not path.is_dir() and _is_named_as_log(path):
        there = _not_understood(path) if path.is_file() else _no_file(path)
        yield UnreadableLog(path, there)
    for entry in entries:
        yield from _open_below(entry, options)


def _is_named_as_log(path: Path) -> bool:
    return path.name.endswith(tuple(s + p for s in _LOG_SUFFIXES for p in _PACKED_SUFFIXES))


def _visible(folder: Path) -> Iterable[Path]:
    """Entries by name, without hidden ones and links to folders, which may lead in circles."""
    entries = sorted(folder.iterdir())
    return [
        e for e in entries if not e.name.startswith(".") and not (e.is_symlink() and e.is_dir())
    ]
