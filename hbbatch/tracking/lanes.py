"""How many sequences are stepped side by side."""

from __future__ import annotations

from typing import Final

DETECTIONS_PER_STEP: Final = 1000
"""Where a lock step's cost is its rows and no longer the number of its operations, while the rows
still fit a core's cache (docs/performance.md)."""


def lane_count(frames: int, detections: int) -> int:
    """How many sequences to step at a time, so that steps hold `DETECTIONS_PER_STEP`.

    Args:
        frames: of all sequences of the group.
        detections: in them.
    """
    return max(1, round(DETECTIONS_PER_STEP * frames / max(detections, 1)))
