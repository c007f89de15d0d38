"""How packed filters hold boxes, and turns of many vectors at once."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.motion.constants import SMALLEST_SIZE_M

Single = NDArray[np.float32]
IntArray = NDArray[np.int64]

PACKED: Final = np.array([3, 4, 5, 0, 1, 2, 6])
"""Packed boxes are rows length, width, height, x, y, z, yaw, so that the four axes with motion lie
together. The permutation is its own inverse: it leads there from a box's columns, and back."""

SIZE: Final = slice(0, 3)
PLAN: Final = slice(3, 5)
CENTRE: Final = slice(3, 6)
MOTION: Final = slice(3, 7)
YAW_ROW: Final = 6


class Heading(NamedTuple):
    """A turn by the heading of each track.

    Attributes:
        cos: `(n,)`.
        sines: `(2, n)` minus sine and sine.
    """

    cos: Single
    sines: Single

    @classmethod
    def of(cls, angle_rad: NDArray[np.floating]) -> Heading:
        """Turn by angles `(n,)`."""
        angle = angle_rad.astype(np.float32)
        sines = np.empty((2, len(angle)), np.float32)
        np.sin(angle, out=sines[1])
        np.negative(sines[1], out=sines[0])
        return cls(np.cos(angle), sines)

    def turn(self, vectors: Single) -> None:
        """Turn vectors `(..., 2, n)` counter-clockwise, in place."""
        crossed = vectors[..., ::-1, :] * self.sines
        vectors *= self.cos
        vectors += crossed

    def turn_back(self, vectors: Single) -> None:
        """Turn vectors `(..., 2, n)` clockwise, in place."""
        crossed = vectors[..., ::-1, :] * self.sines[::-1]
        vectors *= self.cos
        vectors += crossed


def difference(measured: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Measured packed boxes minus prior ones, both `(7, n)`.

    Returns:
        The difference, yaw in [-π/2, π/2) as if a half turn did not matter, and the cosine of the
        headings' difference: negative where the measured one points the other way.
    """
    apart = measured - prior
    yaw = apart[YAW_ROW]
    agreement: FloatArray = np.cos(yaw)
    yaw += np.pi / 2
    yaw %= np.pi
    yaw -= np.pi / 2
    return apart, agreement


def keep_sizes(boxes: FloatArray, change: Single, per: Single | float) -> None:
    """Cut changes that would leave a size below `SMALLEST_SIZE_M`, in place.

    Args:
        boxes: `(7, n)` packed, before the change.
        change: `(7 or more, n)`, per second if `per` is one over the seconds it lasts.
        per: `(n,)` or one for all.
    """
    least = (SMALLEST_SIZE_M - boxes[SIZE]) * per
    np.maximum(change[SIZE], least, out=change[SIZE], casting="same_kind")
