"""Commands measured from outside: how long they take, and processor time of all they start."""

from __future__ import annotations

import ctypes
import os
import resource
import subprocess
import sys
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

_SET_CHILD_SUBREAPER: Final = 36
"""Of prctl(2)."""

_OWN_TASKS: Final = Path("/proc/self/task")


@dataclass(frozen=True)
class Measured:
    """What came of commands that ran at once.

    Attributes:
        ended: what each said, and its exit status.
        wall_s: from the start of the first to the end of the last.
        cpu_s: processor time of them and of the processes they started, those that end later, too.
    """

    ended: list[subprocess.CompletedProcess[str]]
    wall_s: float
    cpu_s: float


@dataclass(frozen=True)
class Command:
    """A command line, and the cores that it may run on (None: all)."""

    arguments: Sequence[str]
    cores: Collection[int] | None = None


def measured(commands: Sequence[Command]) -> Measured:
    """Run commands at once, to the end of all."""
    before, before_s = _children(), _children_cpu_s()
    with _orphans_adopted():
        start = time.perf_counter()
        running = [_started(command) for command in commands]
        ended = [_ended(process) for process in running]
        wall_s = time.perf_counter() - start
        # The process that forks workers notices only then that nobody needs it any more.
        while orphans := _children() - before:
            os.waitpid(min(orphans), 0)
    return Measured(ended, wall_s, _children_cpu_s() - before_s)


def _started(command: Command) -> subprocess.Popen[str]:
    with _kept_to(command.cores):
        return subprocess.Popen(  # noqa: S603 - our own command lines
            command.arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )


def _ended(process: subprocess.Popen[str]) -> subprocess.CompletedProcess[str]:
    stdout, stderr = process.communicate()
    return subprocess.CompletedProcess(process.args, process.returncode, stdout, stderr)


@contextmanager
def _kept_to(cores: Collection[int] | None) -> Iterator[None]:
    """Processes started inside run on some cores only, where the system can do that."""
    if cores is None or not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def _orphans_adopted() -> Iterator[None]:
    """Processes that outlive what started them become children of this one, on Linux."""
    if sys.platform != "linux":
        yield
        return
    library = ctypes.CDLL(None)
    library.prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    try:
        yield
    finally:
        library.prctl(_SET_CHILD_SUBREAPER, 0, 0, 0, 0)


def _children() -> set[int]:
    """Child processes of this one, where the system says."""
    children: set[int] = set()
    for task in _OWN_TASKS.glob("*/children"):
        with suppress(OSError):  # a thread that has ended meanwhile
            children.update(map(int, task.read_text().split()))
    return children


def _children_cpu_s() -> float:
    """Of all child processes that have ended, and theirs."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
