"""Outputs are written aside and renamed, so a killed process leaves the old file or the new one."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from hbbatch.errors import DatasetError


@contextmanager
def write_aside(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success it is flushed to disk and takes its place.

    Raises:
        DatasetError: the folder or the file cannot be written.
    """
    with write_unflushed(path) as aside:
        yield aside
        _flush(aside)


@contextmanager
def write_unflushed(path: Path) -> Iterator[Path]:
    """`write_aside` for what may be lost with the machine's power: it is not waited for the disk.

    Raises:
        DatasetError: the folder or the file cannot be written.
    """
    with writing(path), _beside(path) as aside:
        yield aside
        aside.replace(path)


@contextmanager
def replaced_together(paths: Sequence[Path], gone: Sequence[Path] = ()) -> Iterator[list[Path]]:
    """Yield temporary paths beside `paths`; on success all take their places, `gone` are removed.

    Nothing is touched before all is written and flushed. The first path vouches for the others: it
    is removed before any of them changes and comes last, so that a process killed in between never
    leaves it beside files of another time.

    Raises:
        DatasetError: a folder or file cannot be written.
    """
    with ExitStack() as stack:
        asides = []
        for path in paths:
            with writing(path):
                asides.append(stack.enter_context(_beside(path)))
        yield asides
        for path, aside in zip(paths, asides, strict=True):
            with writing(path):
                _flush(aside)
        with locked(paths[0].parent):  # or two would take each other's places
            for path in (paths[0], *gone):
                with writing(path):
                    path.unlink(missing_ok=True)
            for path, aside in reversed([*zip(paths, asides, strict=True)]):
                with writing(path):
                    aside.replace(path)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Errors of the file system inside are about a file that is being written."""
    try:
        yield
    except OSError as error:
        raise DatasetError(
            f"{path}: cannot be written ({error.strerror or error}). "
            "Check the folder's permissions and free space, or choose another place."
        ) from error


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """A temporary path in the folder of `path`, which is made if need be; gone at the end."""
    aside = path.parent / f".{path.name}.{os.getpid()}.partial"
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield aside
    finally:
        with suppress(FileNotFoundError):
            aside.unlink()


def _flush(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())


@contextmanager
def locked(folder: Path, *, wait: bool = True) -> Iterator[None]:
    """Let one process at a time change what a folder holds; the folder is made if need be.

    Args:
        folder: which.
        wait: for a process that has it already.

    Raises:
        DatasetError: the folder cannot be made or locked, or another process has it.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    try:
        _lock(handle, folder, wait)
        yield
    finally:
        os.close(handle)


def _lock(handle: int, folder: Path, wait: bool) -> None:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError as error:
        why = "another hbbatch is writing there" if isinstance(error, BlockingIOError) else error
        raise DatasetError(
            f"{folder}: cannot be locked ({why}). Try again when it is free."
        ) from error
