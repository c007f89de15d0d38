"""Steps of the ego vehicle that stick out from those around them, as where a receiver corrects."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.sources.base import IntArray

_BOUND_M: Final = 0.25
_NEIGHBOURS: Final = 4
"""Steps on either side that say what a step should have been."""

_SUDDEN_M_S2: Final = 30.0
"""No vehicle accelerates like this: three times what tyres hold."""

_LONGEST_STEP_S: Final = 0.25
"""Over longer steps a vehicle may well change its speed by more than the bound."""

_SHORTEST_STEP_S: Final = 1e-9
_SHOWN: Final = 10


def jumps_problem(translations_m: FloatArray, stamps_ns: IntArray) -> str | None:
    """What to say of steps that are off by more than 0.25 m; None where there are none.

    A step is held against the median velocity of the steps around it, times its duration; and where
    the velocity changes suddenly against that of the steps before, since a receiver may correct
    itself over many steps, of which the first one is named.

    Args:
        translations_m: `(n, 3)` positions in the world frame.
        stamps_ns: `(n,)` their times.
    """
    if len(stamps_ns) < 2 * _NEIGHBOURS + 2:
        return None
    seconds = np.diff(stamps_ns)[:, None] / 1e9
    # Positions of a damaged log may be too far apart to square.
    with np.errstate(over="ignore", invalid="ignore"):
        off_m = _off_m(np.diff(translations_m, axis=0), seconds)
    jumps = np.flatnonzero((off_m > _BOUND_M) & (seconds[:, 0] <= _LONGEST_STEP_S))
    if not len(jumps):
        return None
    shown = ", ".join(str(frame + 1) for frame in jumps[:_SHOWN])
    more = f" and {len(jumps) - _SHOWN} more" if len(jumps) > _SHOWN else ""
    return f"ego pose jumps at frames {shown}{more} (by up to {off_m[jumps].max():.2f} m)"


def _off_m(steps_m: FloatArray, seconds: FloatArray) -> FloatArray:
    """How far each step is off, `(n,)`; 0 where it is within the bound for certain."""
    velocity_m_s = steps_m / np.maximum(seconds, _SHORTEST_STEP_S)
    change_m_s = np.diff(velocity_m_s, axis=0, prepend=velocity_m_s[:1])
    sudden = np.linalg.norm(change_m_s, axis=1) > _SUDDEN_M_S2 * seconds[:, 0]
    around, before = _around(velocity_m_s), _before(velocity_m_s)
    off_m = np.zeros(len(steps_m))
    # Medians take long, and are of use where the velocity changes at all.
    rows = np.flatnonzero(sudden | _may_be_off(around, seconds))
    off_m[rows] = _off_median_m(steps_m[rows], around[:, rows], seconds[rows])
    rows = np.flatnonzero(sudden)
    off_before_m = _off_median_m(steps_m[rows], before[:, rows], seconds[rows])
    off_m[rows] = np.maximum(off_m[rows], off_before_m)
    return off_m


def _around(velocity_m_s: FloatArray) -> FloatArray:
    """Velocities of each step and those on either side, `(k, n, 3)`; beyond the ends as inside."""
    width = ((_NEIGHBOURS, _NEIGHBOURS), (0, 0))
    padded = np.pad(velocity_m_s, width, mode="reflect", reflect_type="odd")
    return _windows(padded, 2 * _NEIGHBOURS + 1)


def _before(velocity_m_s: FloatArray) -> FloatArray:
    """Velocities of the steps before each, `(k, n, 3)`."""
    padded = np.pad(velocity_m_s, ((_NEIGHBOURS, 0), (0, 0)), mode="edge")
    return _windows(padded[:-1], _NEIGHBOURS)


def _windows(values: FloatArray, width: int) -> FloatArray:
    """Stretches of rows, not copied; theirs is the first axis, over which numpy reduces fastest."""
    return np.moveaxis(sliding_window_view(values, width, axis=0), -1, 0)


def _may_be_off(around_m_s: FloatArray, seconds: FloatArray) -> NDArray[np.bool_]:
    """Steps whose velocity may differ from the median by as much as matters, `(n,)`.

    The two are no further apart than any two velocities around the step.
    """
    spread_m_s = around_m_s.max(axis=0) - around_m_s.min(axis=0)
    within = np.linalg.norm(spread_m_s * seconds, axis=1) < _BOUND_M / 2
    may_be: NDArray[np.bool_] = ~within | (seconds[:, 0] <= _SHORTEST_STEP_S)
    return may_be


def _off_median_m(steps_m: FloatArray, others_m_s: FloatArray, seconds: FloatArray) -> FloatArray:
    """How far steps are off what the median of velocities makes of their durations, `(n,)`."""
    off_m: FloatArray = np.linalg.norm(steps_m - np.median(others_m_s, axis=0) * seconds, axis=1)
    return off_m
