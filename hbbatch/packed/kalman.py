"""The classical filter for few rows on a CPU: numpy, parameters worked out beforehand.

A lock step on a CPU has about a hundred rows, where a tensor operation is nearly all overhead. So
tracking on a CPU steps these classes instead of the torch modules they are made from, which remain
the definition, the training path and what other devices run (docs/adr/0004-packed-filters.md).

Everything is stored the other way round than in the modules: a row a column of the module's
matrix, a column a track, so that each quantity is contiguous. Rows are ordered such that one
operation serves several quantities.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.motion.columns import Columns, MotionModel, kalman_order
from hbbatch.motion.constants import AXES, FARTHEST, RANGE_UNIT_M
from hbbatch.motion.covariance import pairs
from hbbatch.motion.parameters import KalmanOptions, Parameters
from hbbatch.packed.arrays import FilterArrays, IntArray, Single
from hbbatch.packed.covariance import PackedCovariance
from hbbatch.packed.layout import layout
from hbbatch.packed.network import NO_GAIN, NO_RESIDUAL

DETECTION: Final = Columns({"size_variance": 3, "variance": AXES, "range": 2, "ahead": 2})
"""What is known of a detection before it is matched: variances of its sizes and its motion axes;
its horizontal distance from the sensor in `RANGE_UNIT_M`, its height above it in m; the horizontal
direction it is seen in (world axes, of unit length beyond a metre)."""


def kalman_rows(model: MotionModel) -> dict[str, int]:
    """State of the classical filter. Size variances lie before those of the axes' positions."""
    order = kalman_order(model)
    return {
        "velocity": AXES,
        "acceleration": AXES * (order - 2),
        "size_variance": 3,
        "covariance": AXES * len(pairs(order)),
        "heading_vote": 1,
        "noise": AXES,
        "size_noise": 3,
    }


class PackedKalman:
    """`model.kalman.KalmanFilter`, packed: what the kernels step it with.

    Boxes `(7, m)` float64 are packed, states `(height, m)` float32; a column is a track.

    Attributes:
        height: rows of the state.
        layout: of the state.
        newborn: `(height, kinds)` a track of each kind before its detection is looked at.
    """

    def __init__(
        self, parameters: Parameters, options: KalmanOptions, rows: Columns | None = None
    ) -> None:
        """Parameters of the shapes that the options ask for.

        Args:
            parameters: arrays by name.
            options: of the filter.
            rows: of a larger state that holds those of `kalman_rows`.
        """
        self._rows = rows or Columns(kalman_rows(options.model))
        self._covariance = PackedCovariance(kalman_order(options.model))
        self._log_r = parameters["log_r"]
        self._log_r_range = parameters["log_r_range"]
        self._r_size = np.exp(parameters["log_r_size"])
        self.height = self._rows.width
        self.layout = layout(self._rows, options.model, self._covariance.mixed)
        self.newborn = self._newborn(parameters)
        self._residual_layers, self._gain_layers = NO_RESIDUAL, NO_GAIN

    def _newborn(self, parameters: Parameters) -> Single:
        rows = self._rows
        state = np.zeros((self.height, len(parameters["log_q"])), np.float32)
        variances = np.exp(parameters["log_initial"]).transpose(1, 2, 0)
        self._covariance.start(state[rows["covariance"]], variances)
        state[rows["heading_vote"]] = 1.0
        state[rows["noise"]] = np.exp(by_kind(parameters["log_q"]))
        state[rows["size_noise"]] = np.exp(by_kind(parameters["log_q_size"]))
        return state

    def times(self, dt_s: Single) -> Single:
        """What `predict` needs to know of time steps `(n,)`; a column each.

        Rows of seconds, half of them, tenths, their inverse; then weights of covariances.
        """
        rows = np.stack([dt_s, 0.5 * dt_s, 10.0 * dt_s, 1.0 / dt_s])
        return np.concatenate([rows, self._covariance.weights(dt_s)])

    def detections(self, sight_m: FloatArray, kinds: IntArray) -> Single:
        """`(n, DETECTION.width)` of detections seen along `sight_m` `(n, 3)`."""
        seen = np.empty((len(kinds), DETECTION.width), np.float32)
        x, y, up = sight_m.T.astype(np.float32)
        distance = np.maximum(np.sqrt(x * x + y * y), 1.0)
        far = distance / RANGE_UNIT_M
        log_r = self._log_r_range.take(kinds, axis=0)
        log_r *= np.minimum(far, FARTHEST)[:, None]
        log_r += self._log_r.take(kinds, axis=0)
        np.exp(log_r, out=seen[:, DETECTION["variance"]])
        seen[:, DETECTION["size_variance"]] = self._r_size.take(kinds, axis=0)
        for row, value in enumerate((far, up, x / distance, y / distance)):
            seen[:, DETECTION["range"].start + row] = value
        return seen

    def arrays(self) -> FilterArrays:
        """What the kernels are given of it."""
        return FilterArrays(self.layout, self.newborn, *self._residual_layers, *self._gain_layers)


def by_kind(parameter: Single) -> Single:
    """A parameter `(kinds, k)` as `(k, kinds)`, to be indexed by kind."""
    return np.ascontiguousarray(parameter.T)
