"""Bounds on what a test may cost: seconds of the processor, and memory at once."""

from __future__ import annotations

import resource
import signal
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_MIB = 2**20
_HEADROOM_BYTES = 3 * 2**30
"""Of address space, so that a runaway ends in a MemoryError and not with the machine."""


class HangError(BaseException):
    """Raised out of a loop that does not end; no code catches it as damage of a file."""


@contextmanager
def bounded(cpu_seconds: float, mebibytes: float) -> Iterator[None]:
    """Fail where a block computes longer than that, or holds more memory than that at once.

    Memory is what Python, numpy and the unpackers' results take. A block that waits is pytest's
    timeout to end.
    """

    def give_up(*_: Any) -> None:
        raise HangError(f"more than {cpu_seconds} s of processor time")

    before = resource.getrlimit(resource.RLIMIT_AS)
    former = signal.signal(signal.SIGVTALRM, give_up)
    resource.setrlimit(resource.RLIMIT_AS, (_address_space() + _HEADROOM_BYTES, before[1]))
    tracemalloc.start()
    signal.setitimer(signal.ITIMER_VIRTUAL, cpu_seconds)
    try:
        yield
        peak = tracemalloc.get_traced_memory()[1]
        assert peak < mebibytes * _MIB, f"{peak / _MIB:.0f} MiB at once"
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        tracemalloc.stop()
        resource.setrlimit(resource.RLIMIT_AS, before)
        signal.signal(signal.SIGVTALRM, former)


def _address_space() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return pages * resource.getpagesize()
