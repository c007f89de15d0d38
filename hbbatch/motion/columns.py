"""A filter's state is one float32 matrix, a row a track; this names its columns.

One matrix means that birth, death and compaction of tracks are single copies.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from hbbatch.motion.constants import AXES
from hbbatch.motion.covariance import pairs

MotionModel = Literal["cv", "ca", "ct"]
"""Constant velocity, constant acceleration, coordinated turn."""


class Columns(dict[str, slice]):
    """Named column ranges laid side by side."""

    def __init__(self, widths: Mapping[str, int]) -> None:
        """Lay out the columns in the order given."""
        super().__init__()
        start = 0
        for name, width in widths.items():
            self[name] = slice(start, start + width)
            start += width
        self.width = start


def kalman_order(model: MotionModel) -> int:
    """How many derivatives an axis has, its position counted."""
    return 3 if model == "ca" else 2


def kalman_columns(model: MotionModel) -> Columns:
    """State of the classical filter."""
    return Columns(
        {
            "velocity": AXES,
            **({"acceleration": AXES} if model == "ca" else {}),
            "covariance": AXES * len(pairs(kalman_order(model))),
            "size_variance": 3,
            "heading_vote": 1,
            "class_code": 1,
        }
    )
