"""Where a recording pauses for longer than a tracker can bridge."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from hbbatch.config import ManagementSettings
from hbbatch.sources.base import IntArray

_USUAL_INTERVAL_NS: Final = 100_000_000


def threshold_ns(stamps_ns: IntArray, max_gap_s: float | None) -> int:
    """The longest time without a frame that a sequence may have.

    Args:
        stamps_ns: `(m,)` stamps of its frames, sorted.
        max_gap_s: what was asked for; None: as many frames as a track survives without a detection,
            at the recording's own rate (median interval), or at 10 Hz where it is faster.
    """
    if max_gap_s is not None:
        return int(max_gap_s * 1e9)
    usual_ns = int(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0
    return ManagementSettings().max_misses * max(usual_ns, _USUAL_INTERVAL_NS)


def parts(stamps_ns: IntArray, max_gap_s: float | None) -> list[slice]:
    """The stretches between pauses, in order; a single one where there is no pause."""
    breaks = np.flatnonzero(np.diff(stamps_ns) > threshold_ns(stamps_ns, max_gap_s)) + 1
    edges = [0, *breaks.tolist(), len(stamps_ns)]
    return [slice(first, last) for first, last in pairwise(edges)]
