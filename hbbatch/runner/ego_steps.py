"""Steps of the ego vehicle that stick out from those around them, as where a receiver corrects."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hbbatch.boxes import FloatArray
from hbbatch.sources.base import IntArray

_BOUND_M: Final = 0.25
_NEIGHBOURS: Final = 4
"""Steps on either side that say what a step should have been."""

_LONGEST_STEP_S: Final = 0.25
"""Over longer steps a vehicle may well change its speed by more than the bound."""

_SHOWN: Final = 10


def jumps_problem(translations_m: FloatArray, stamps_ns: IntArray) -> str | None:
    """What to say of steps that are off by more than 0.25 m; None where there are none.

    A step is held against the median velocity of the steps around it, times its duration.

    Args:
        translations_m: `(n, 3)` positions in the world frame.
        stamps_ns: `(n,)` their times.
    """
    if len(stamps_ns) < 2 * _NEIGHBOURS + 2:
        return None
    seconds = np.diff(stamps_ns)[:, None] / 1e9
    steps_m = np.diff(translations_m, axis=0)
    lasting = np.maximum(seconds, 1e-9)
    padded = np.pad(
        steps_m / lasting, ((_NEIGHBOURS, _NEIGHBOURS), (0, 0)), mode="reflect", reflect_type="odd"
    )
    usual_m_s = np.median(sliding_window_view(padded, 2 * _NEIGHBOURS + 1, axis=0), axis=-1)
    off_m = np.linalg.norm(steps_m - usual_m_s * seconds, axis=1)
    jumps = np.flatnonzero((off_m > _BOUND_M) & (seconds[:, 0] <= _LONGEST_STEP_S))
    if not len(jumps):
        return None
    shown = ", ".join(str(frame + 1) for frame in jumps[:_SHOWN])
    more = f" and {len(jumps) - _SHOWN} more" if len(jumps) > _SHOWN else ""
    return f"ego pose jumps at frames {shown}{more} (by up to {off_m[jumps].max():.2f} m)"
