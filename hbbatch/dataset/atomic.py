"""Outputs are written aside and renamed, so a killed process leaves the old file or the new one."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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
    aside = path.parent / f".{path.name}.{os.getpid()}.partial"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield aside
            aside.replace(path)
        finally:
            with suppress(FileNotFoundError):
                aside.unlink()
    except OSError as error:
        raise DatasetError(
            f"{path}: cannot be written ({error.strerror or error}). "
            "Check the folder's permissions and free space, or choose another place."
        ) from error


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
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise DatasetError(
            f"{folder}: cannot be written ({error.strerror or error}). "
            "Check the folder's permissions and free space, or choose another place."
        ) from error
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
