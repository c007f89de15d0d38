"""Bytes kept in memory while they are few, and in an unnamed temporary file once they are many."""

from __future__ import annotations

import os
import tempfile
import weakref
from pathlib import Path
from typing import Final

_IN_MEMORY_BYTES: Final = 64 * 2**20


class Spool:
    """Append, then read any part. The file has no name and ends with the object."""

    def __init__(self, in_memory_bytes: int = _IN_MEMORY_BYTES) -> None:
        self._limit = in_memory_bytes
        self._memory = bytearray()
        self._file: int | None = None

    def append(self, data: bytes | memoryview) -> None:
        """Add bytes at the end."""
        self._memory += data
        if len(self._memory) > self._limit:
            self._flush()

    def read(self, start: int, size: int) -> bytes | memoryview:
        """Bytes from a position; nothing is appended after the first call."""
        if self._file is None:
            return memoryview(self._memory)[start : start + size]
        if self._memory:
            self._flush()
        return os.pread(self._file, size, start)

    def _flush(self) -> None:
        if self._file is None:
            self._file, name = tempfile.mkstemp(prefix="hbbatch-")
            Path(name).unlink()
            weakref.finalize(self, os.close, self._file)
        rest = memoryview(self._memory)
        while rest:
            rest = rest[os.write(self._file, rest) :]
        rest.release()
        self._memory = bytearray()
