"""A command measured from outside: how long it took, and the processor time of all it started."""

from __future__ import annotations

import ctypes
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

_SET_CHILD_SUBREAPER: Final = 36
"""Of prctl(2)."""

_OWN_TASKS: Final = Path("/proc/self/task")


@dataclass(frozen=True)
class Measured:
    """What came of a command.

    Attributes:
        status: its exit status.
        stdout, stderr: what it said.
        wall_s: from its start to its end.
        cpu_s: processor time of it and of the processes it started, those that end after it, too.
    """

    status: int
    stdout: str
    stderr: str
    wall_s: float
    cpu_s: float


def measured(command: Sequence[str]) -> Measured:
    """Run a command to its end."""
    before, before_s = _children(), _children_cpu_s()
    with _orphans_adopted():
        start = time.perf_counter()
        done = subprocess.run(  # noqa: S603 - our own command lines
            command, capture_output=True, text=True
        )
        wall_s = time.perf_counter() - start
        # The process that forks workers notices only then that nobody needs it any more.
        for orphan in _children() - before:
            os.waitpid(orphan, 0)
    cpu_s = _children_cpu_s() - before_s
    return Measured(done.returncode, done.stdout, done.stderr, wall_s, cpu_s)


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
    tasks = _OWN_TASKS.glob("*/children")
    return {int(child) for task in tasks for child in task.read_text().split()}


def _children_cpu_s() -> float:
    """Of all child processes that have ended, and theirs."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
