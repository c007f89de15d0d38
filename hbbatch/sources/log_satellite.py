"""Satellite fixes and Imu orientations of a log, joined to poses of the Imu's frame."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from hbbatch.boxes import FloatArray
from hbbatch.sources.base import IntArray
from hbbatch.sources.messages.satellite import Fix, Orientation, east_north_up
from hbbatch.sources.transforms import EXTRAPOLATION_NS, frame_name, is_rotation

WORLD: Final = "local_enu"
"""Name of the world frame: east, north, up at the first fix."""


@dataclass(frozen=True)
class SatelliteTrack:
    """Poses of a frame in `WORLD`."""

    child: str
    stamps_ns: IntArray
    translation_m: FloatArray
    rotation: FloatArray


@dataclass
class _Samples:
    frame_id: str = ""
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def sorted(self, width: int) -> tuple[IntArray, FloatArray]:
        """Stamps and values in time order, one a stamp."""
        stamps_ns, first = np.unique(np.array(self.stamps_ns), return_index=True)
        return stamps_ns, np.array(self.values).reshape(-1, width)[first]


class SatelliteMessages:
    """Fixes and orientations by topic; of several topics the one with the most messages counts."""

    def __init__(self) -> None:
        self._fixes: dict[str, _Samples] = {}
        self._orientations: dict[str, _Samples] = {}

    def add(self, topic: str, part: Fix | Orientation, log_time_ns: int) -> None:
        """Take a message; one without a stamp counts at its log time."""
        if isinstance(part, Fix):
            samples = self._fixes.setdefault(topic, _Samples())
            values: tuple[float, ...] = (part.latitude_deg, part.longitude_deg, part.altitude_m)
        else:
            if not is_rotation(np.array([part.rotation], dtype=np.float64))[0]:
                return
            samples = self._orientations.setdefault(topic, _Samples())
            values = part.rotation
        samples.frame_id = samples.frame_id or frame_name(part.frame_id)
        samples.stamps_ns.append(part.stamp_ns or log_time_ns)
        samples.values.extend(values)

    @property
    def usable(self) -> bool:
        """Whether there are fixes, and orientations at the time of some of them."""
        return bool(self._fixes and self._orientations) and len(self.track().stamps_ns) > 0

    def track(self) -> SatelliteTrack:
        """A pose a fix that orientations surround."""
        fixes, orientations = _richest(self._fixes), _richest(self._orientations)
        stamps_ns, places = fixes.sorted(3)
        times_ns, quaternions = orientations.sorted(4)
        near = (stamps_ns >= times_ns[0] - EXTRAPOLATION_NS) & (
            stamps_ns <= times_ns[-1] + EXTRAPOLATION_NS
        )
        translation_m = east_north_up(places)[near]
        rotation = _at(times_ns, quaternions, stamps_ns[near])
        return SatelliteTrack(orientations.frame_id, stamps_ns[near], translation_m, rotation)


def _richest(topics: dict[str, _Samples]) -> _Samples:
    return topics[max(sorted(topics), key=lambda topic: len(topics[topic].stamps_ns))]


def _at(times_ns: IntArray, quaternions: FloatArray, stamps_ns: IntArray) -> FloatArray:
    """Orientations at times; before the first and after the last, that one."""
    if len(times_ns) == 1:
        rotation: FloatArray = np.repeat(quaternions, len(stamps_ns), axis=0)
        return rotation
    start_ns = times_ns[0]
    slerp = Slerp((times_ns - start_ns) / 1e9, Rotation.from_quat(quaternions))
    within = np.clip(stamps_ns, start_ns, times_ns[-1])
    turned: FloatArray = slerp((within - start_ns) / 1e9).as_quat()
    return turned
