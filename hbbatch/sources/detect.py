"""Which format a path holds, found from its content; formats are added here."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hbbatch.errors import SourceError
from hbbatch.sources.base import Source, SourceOptions
from hbbatch.sources.kitti import KittiSource, is_kitti_folder


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
        "a KITTI tracking folder (calib, oxts, label_02)",
        is_kitti_folder,
        KittiSource,
    ),
)


def open_sources(path: Path, options: SourceOptions) -> list[Source]:
    """The source at a path, or all sources below it when it is a folder of logs.

    Raises:
        SourceError: nothing there is understood.
    """
    if not path.exists():
        raise SourceError(f"{path}: does not exist. Check the path.")
    sources = list(_open_below(path, options))
    if not sources:
        found = "an empty folder" if path.is_dir() and not any(path.iterdir()) else "not understood"
        known = "; ".join(known_format.description for known_format in FORMATS)
        raise SourceError(f"{path}: {found}. Can be read: {known}.")
    return sources


def _open_below(path: Path, options: SourceOptions) -> Iterator[Source]:
    chosen = next((f for f in FORMATS if f.recognises(path)), None)
    if chosen is not None:
        yield chosen.open(path, options)
    elif path.is_dir():
        for entry in _visible(path):
            yield from _open_below(entry, options)


def _visible(folder: Path) -> Iterable[Path]:
    with os.scandir(folder) as entries:
        names = sorted(e.name for e in entries if not e.name.startswith(".") and not e.is_symlink())
    return (folder / name for name in names)
