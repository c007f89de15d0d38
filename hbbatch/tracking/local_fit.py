"""Local least squares over the rows of a track: what its neighbours in time say of each row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.packed import kernels
from hbbatch.tracking.frames import IntArray

_RIDGE = 1e-8
"""Keeps what too few neighbours tell solvable: no slope."""


def local_fit(
    owner: IntArray, time_s: FloatArray, values: FloatArray, weights: FloatArray, reach_s: float
) -> FloatArray:
    """Values smoothed by a parabola through the neighbours of each row, `(n, k)`.

    Weights fall with the time between two rows by (1 - (t / reach)^2)^2 (local regression:
    Cleveland 1979). A row with fewer than four neighbours keeps its values, or nearly so.

    Args:
        owner: `(n,)` track of each row, one after the other.
        time_s: `(n,)` rising within a track.
        values: `(n, k)` up to eight columns.
        weights: `(n,)` of each row, above zero.
        reach_s: time to the farthest neighbour.
    """
    fit = _compiled if kernels.AVAILABLE else by_numpy
    return fit(owner, time_s, values, weights, reach_s)


def _compiled(
    owner: IntArray, time_s: FloatArray, values: FloatArray, weights: FloatArray, reach_s: float
) -> FloatArray:
    fitted = np.empty_like(values)
    kernels.local_fit(owner, time_s, values, weights, fitted, reach_s)
    return fitted


def by_numpy(
    owner: IntArray, time_s: FloatArray, values: FloatArray, weights: FloatArray, reach_s: float
) -> FloatArray:
    """The same without the kernel: neighbour by neighbour for all rows at once."""
    moments = np.zeros((len(owner), 5))
    moments[:, 0] = weights
    sums = np.zeros((len(owner), 3, values.shape[1]))
    for shift in range(1, len(owner)):
        apart = (time_s[shift:] - time_s[:-shift]) / reach_s
        (early,) = np.nonzero((owner[shift:] == owner[:-shift]) & (apart < 1.0))
        if not len(early):
            break
        late, apart = early + shift, apart[early]
        _add(moments, sums, early, late, apart, values, weights)
        _add(moments, sums, late, early, -apart, values, weights)
    power = np.arange(3)
    matrix = moments[:, power[:, None] + power]
    matrix[:, [1, 2], [1, 2]] += _RIDGE * moments[:, :1]
    fitted: FloatArray = values + np.linalg.solve(matrix, sums)[:, 0]
    return fitted


def _add(
    moments: FloatArray,
    sums: FloatArray,
    to: NDArray[np.intp],
    of: NDArray[np.intp],
    apart: FloatArray,
    values: FloatArray,
    weights: FloatArray,
) -> None:
    """Take rows `of` in at rows `to`, so far apart of the reach."""
    weight = weights[of] * (1.0 - apart**2) ** 2
    moments[to] += weight[:, None] * apart[:, None] ** np.arange(5)
    step = values[of] - values[to]
    sums[to] += (weight[:, None] * apart[:, None] ** np.arange(3))[:, :, None] * step[:, None, :]
