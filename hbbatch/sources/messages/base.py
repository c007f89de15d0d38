"""What the readers of message types give, and what they share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hbbatch.boxes import FloatArray


@dataclass(frozen=True)
class DetectionMessage:
    """A decoded detection message.

    Attributes:
        stamp_ns: header stamp, 0 when unset.
        frame_id: frame of the boxes as written, empty when the message names none.
        boxes: `(n, 7)` in that frame, convention of `hbbatch.boxes`.
        scores: `(n,)` as logged, NaN where the message gives none.
        class_names: n names.
    """

    stamp_ns: int
    frame_id: str
    boxes: FloatArray
    scores: FloatArray
    class_names: Sequence[str]


@dataclass(frozen=True)
class TransformSample:
    """parent_from_child at one time.

    Attributes:
        parent: frame id as written.
        child: frame id as written.
        stamp_ns: header stamp, 0 when unset.
        translation_m: three numbers.
        rotation: quaternion x, y, z, w, not necessarily of unit length.
    """

    parent: str
    child: str
    stamp_ns: int
    translation_m: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


def stamp_ns(stamp: Any) -> int:
    """A builtin_interfaces/Time in nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def quaternion_yaw(rotation: FloatArray) -> FloatArray:
    """Heading about z of quaternions x, y, z, w of any length but zero, `(n, 4)` to `(n,)`.

    A quaternion of zeros, which senders leave when they know no orientation, gives 0.
    """
    x, y, z, w = rotation.T
    yaw: FloatArray = np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return yaw
