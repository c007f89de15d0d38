"""How this process takes memory from the system."""

from __future__ import annotations

from typing import Final

import numpy as np

_PIECE_BYTES: Final = 2**25 - 2**13
"""Just below the largest piece that glibc's allocator learns from."""


def keep_freed_memory() -> None:
    """Have the next to take memory get what was freed last, not pages that are new to the process.

    A block of a log, and a part of the sequences being tracked, take some megabytes and free them,
    again and again. The allocator of glibc
    would return them to the system each time, and pages that come from there must be cleared and
    mapped first. It stops to do so for pieces up to the size of the largest that was ever freed
    (mallopt(3), M_MMAP_THRESHOLD): one is, here, that was never written to and so costs nothing.
    Other allocators take no notice.
    """
    np.empty(_PIECE_BYTES, dtype=np.uint8)
