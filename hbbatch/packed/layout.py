"""Where the compiled kernels find the parts of a filter's state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hbbatch.motion.columns import Columns, MotionModel, kalman_order
from hbbatch.packed.arrays import IntArray

_CLASSICAL = ("velocity", "acceleration", "size_variance", "covariance", "heading_vote", "noise")
_LEARNED = ("one", "log_size", "elapsed", "tenths", "history")


def layout(rows: Columns, model: MotionModel, mixed: Sequence[tuple[int, int]]) -> IntArray:
    """The layout that kernels take, in the order of `c/state.h`.

    Args:
        rows: of the state; those of the classical filter and perhaps of the learned one.
        model: of the motion.
        mixed: covariance blocks that a time step adds to others: target and source.
    """
    learned = "correction" in rows
    start = {name: part.start for name, part in rows.items()}
    parts = [start[name] for name in (*_CLASSICAL, "size_noise")]
    parts += [start.get(name, -1) for name in ("correction", *_LEARNED)]
    parts.append(rows["history"].stop if learned else -1)
    parts += [start.get(name, -1) for name in ("q", "learned", "counters", "inverse_dt")]
    head = [kalman_order(model), int(model == "ct"), *parts]
    return np.array([*head, *(number for pair in mixed for number in pair)], np.int64)
