"""How packed filters hold boxes."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Single = NDArray[np.float32]
IntArray = NDArray[np.int64]

PACKED: Final = np.array([3, 4, 5, 0, 1, 2, 6])
"""Packed boxes are rows length, width, height, x, y, z, yaw, so that the four axes with motion lie
together. The permutation is its own inverse: it leads there from a box's columns, and back."""

NONE: Final = np.empty((0, 8), np.float32)
NOTHING: Final = np.empty(0, np.float32)
"""For layers and limits, which the learned filter has and the classical one has not."""
