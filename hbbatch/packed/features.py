"""What the networks see, row by row, and where their modules have it.

The modules give each network its features in an order and units of their own (`model.hybrid`).
Here rows lie as the filter's state has them and keep the state's units; order and units go into
the weights of the first layer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hbbatch.motion.columns import Columns
from hbbatch.motion.constants import AXES, FEATURE_LIMIT, INNOVATION_UNIT, RATE_UNIT
from hbbatch.motion.parameters import HybridOptions
from hbbatch.packed.arrays import PACKED, Single

_MOTION_THEN_SIZE = [3, 4, 5, 6, 0, 1, 2]
"""Rows of a packed innovation in the order of the module."""


class _Group(NamedTuple):
    """Features that lie together in the module.

    Attributes:
        name: of the rows here.
        rows: which of them, in the module's order.
        factor: of each, from the state's unit to the module's.
    """

    name: str
    rows: Sequence[int] | NDArray[np.integer]
    factor: float | NDArray[np.float64] = 1.0


class Features:
    """Rows of a network's input: memory, a row of ones, kind, and what has limits.

    Attributes:
        rows: the rows by name.
        limit: of the last rows, the most that training saw.
    """

    def __init__(self, rows: Columns, groups: Sequence[_Group]) -> None:
        """Features in the order of the module."""
        self.rows = rows
        self._place = np.concatenate([rows[g.name].start + np.asarray(g.rows) for g in groups])
        factors = [np.broadcast_to(g.factor, len(g.rows)) for g in groups]
        self._factor = np.concatenate(factors).astype(np.float32)
        limit = np.full(rows.width, FEATURE_LIMIT, np.float32)
        limit[self._place] /= self._factor
        self.limit = limit[rows["correction"].start :].copy()

    def layer(self, weights: Single, biases: Single) -> Single:
        """A layer `(outputs, width)` on these rows, given the module's weights and biases."""
        layer = np.zeros((len(weights), self.rows.width), np.float32)
        layer[:, self._place] = weights * self._factor
        layer[:, self.rows["one"].start] = biases
        return layer


def shared_rows(kinds: int, options: HybridOptions) -> dict[str, int]:
    """Rows that both networks see and the state begins with.

    Elapsed are the logarithms of 1 + tenths of a second since the last detection and since birth.
    """
    return {
        "memory": options.memory,
        "one": 1,
        "kind": kinds,
        "correction": 7,
        "log_size": 3,
        "elapsed": 2,
    }


def predict_features(kinds: int, options: HybridOptions) -> Features:
    """What the residual predictor sees."""
    shared = shared_rows(kinds, options)
    rows = Columns({**shared, "tenths": 1, "velocity": AXES, "history": 7 * options.history})
    rate_unit, correction_unit = np.array(RATE_UNIT), np.array(INNOVATION_UNIT)
    history = np.concatenate([7 * entry + PACKED for entry in range(options.history)])
    groups = [
        _Group("memory", range(options.memory)),
        _Group("history", history, 1.0 / np.tile(rate_unit, options.history)),
        _Group("correction", PACKED, 1.0 / correction_unit),
        _Group("velocity", range(AXES), 1.0 / rate_unit[[0, 1, 2, 6]]),
        _Group("elapsed", range(2), 0.5),
        _Group("tenths", range(1)),
        _Group("log_size", range(3)),
        _Group("kind", range(kinds)),
    ]
    return Features(rows, groups)


def update_features(kinds: int, options: HybridOptions) -> Features:
    """What the gain network sees."""
    shared = shared_rows(kinds, options)
    rows = Columns({**shared, "innovation": 7, "from_sensor": 4, "log_spread": AXES})
    unit = np.array(INNOVATION_UNIT)
    groups = [
        _Group("memory", range(options.memory)),
        _Group("innovation", _MOTION_THEN_SIZE, 1.0 / unit),
        _Group("correction", PACKED, 1.0 / unit),
        _Group("log_spread", range(AXES), 0.25),
        _Group("elapsed", range(2), 0.5),
        _Group("from_sensor", [2, 3, 0, 1]),
        _Group("log_size", range(3)),
        _Group("kind", range(kinds)),
    ]
    return Features(rows, groups)
