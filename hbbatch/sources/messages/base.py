"""What the readers of message types give, and what they share.

Readers take decoded messages: objects whose fields are attributes, whichever encoding they come
from. Times are `sec`/`nanosec` in ROS 2, `sec`/`nsec` in JSON and `seconds`/`nanos` in protobuf.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isfinite, remainder, tau
from typing import Any, Final, NamedTuple

import numpy as np

from hbbatch.boxes import FloatArray

NAN: Final = float("nan")
NO_ROTATION: Final = (0.0, 0.0, 0.0, 0.0)
"""The quaternion of what has none; its yaw is 0."""


@dataclass(frozen=True)
class DetectionMessage:
    """A decoded detection message.

    Attributes:
        stamp_ns: header stamp, 0 when unset.
        frame_id: frame of the boxes as written, empty when the message names none.
        boxes: `(n, 7)` in that frame, convention of `hbbatch.boxes`.
        scores: `(n,)` as logged, NaN where the message gives none.
        class_names: n names.
        foreign: boxes of the message that are in another frame than the others, left out.
        unsure_yaws: boxes whose yaw the sender marks as unknown or possibly off by π.
    """

    stamp_ns: int
    frame_id: str
    boxes: FloatArray
    scores: FloatArray
    class_names: Sequence[str]
    foreign: int = 0
    unsure_yaws: int = 0


class Item(NamedTuple):
    """One detected object of a message.

    Attributes:
        position_m: centre x, y, z.
        size_m: length, width, height.
        rotation: quaternion x, y, z, w of any length.
        score: NaN where there is none.
        class_name: as written.
        frame_id: empty where the object names no frame of its own.
        yaw: where the message gives one; it counts, to the last bit, instead of the rotation.
    """

    position_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    score: float
    class_name: str
    frame_id: str = ""
    yaw: float | None = None


@dataclass(frozen=True)
class TransformSample:
    """parent_from_child at one time.

    Attributes:
        parent: frame id as written.
        child: frame id as written; empty where the message does not say what the pose is of.
        stamp_ns: header stamp, 0 when unset.
        translation_m: three numbers.
        rotation: quaternion x, y, z, w, not necessarily of unit length.
    """

    parent: str
    child: str
    stamp_ns: int
    translation_m: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


def detection_message(
    stamp: int, frame_id: str, items: Iterable[Item], unsure_yaws: int = 0
) -> DetectionMessage:
    """Objects of one frame: the message's, else that of the first object that names one."""
    listed = list(items)
    frame = frame_id or next((item.frame_id for item in listed if item.frame_id), "")
    kept = [item for item in listed if item.frame_id in {"", frame}]
    rows = [(*item.position_m, *item.size_m, *item.rotation) for item in kept]
    values = np.array(rows, dtype=np.float64).reshape(-1, 10)
    yaws = quaternion_yaw(values[:, 6:])
    for row, item in enumerate(kept):
        if item.yaw is not None:
            # Exact for what lies in [-π, π] already; what is not finite is left out later.
            yaws[row] = remainder(item.yaw, tau) if isfinite(item.yaw) else NAN
    return DetectionMessage(
        stamp_ns=stamp,
        frame_id=frame,
        boxes=np.column_stack([values[:, :6], yaws]),
        scores=np.array([item.score for item in kept], dtype=np.float64),
        class_names=[item.class_name for item in kept],
        foreign=len(listed) - len(kept),
        unsure_yaws=unsure_yaws,
    )


def stamp_ns(stamp: Any) -> int:
    """A time or duration in nanoseconds; damaged ones must still fit 64 bits."""
    seconds = stamp.sec if hasattr(stamp, "sec") else stamp.seconds
    for name in ("nanosec", "nsec", "nanos"):
        if hasattr(stamp, name):
            total = int(seconds) * 1_000_000_000 + int(getattr(stamp, name))
            return total if 0 <= total < 2**63 else 0
    raise AttributeError("a time without nanoseconds")


def xyz(vector: Any) -> tuple[float, float, float]:
    """A point or vector."""
    return (vector.x, vector.y, vector.z)


def xyzw(quaternion: Any) -> tuple[float, float, float, float]:
    """A quaternion."""
    return (quaternion.x, quaternion.y, quaternion.z, quaternion.w)


def quaternion_yaw(rotation: FloatArray) -> FloatArray:
    """Heading about z of quaternions x, y, z, w of any length but zero, `(n, 4)` to `(n,)`.

    A quaternion of zeros, which senders leave when they know no orientation, gives 0.
    """
    x, y, z, w = rotation.T
    # Numbers of a damaged message may be too large to square; what is not finite is left out later.
    with np.errstate(over="ignore", invalid="ignore"):
        yaw: FloatArray = np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return yaw
