"""A filter's state is one float32 matrix, a row a track; this names its columns.

One matrix means that birth, death and compaction of tracks are single copies.
"""

from __future__ import annotations

from collections.abc import Mapping


class Columns:
    """Named column ranges laid side by side."""

    def __init__(self, widths: Mapping[str, int]) -> None:
        """Lay out the columns in the order given."""
        self._slices: dict[str, slice] = {}
        start = 0
        for name, width in widths.items():
            self._slices[name] = slice(start, start + width)
            start += width
        self.width = start

    def __getitem__(self, name: str) -> slice:
        return self._slices[name]
