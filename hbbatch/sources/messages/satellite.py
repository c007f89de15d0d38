"""Satellite fixes and inertial measurements: the last resort for poses.

A fix gives a place on the ellipsoid, an Imu an orientation. Together they are the pose of the Imu's
frame in a local frame east, north, up at the first fix; the offset between antenna and Imu, a metre
or two, is left out where the transform tree does not tell it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any, Final

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.sources.messages.base import stamp_ns, xyzw

_SEMI_MAJOR_M: Final = 6_378_137.0
_ECCENTRICITY_2: Final = 6.694_379_990_14e-3
_NO_FIX: Final = -1


@dataclass(frozen=True)
class Fix:
    """A place: degrees and metres, WGS 84."""

    frame_id: str
    stamp_ns: int
    latitude_deg: float
    longitude_deg: float
    altitude_m: float


@dataclass(frozen=True)
class Orientation:
    """An orientation in an east-north-up frame, quaternion x, y, z, w."""

    frame_id: str
    stamp_ns: int
    rotation: tuple[float, float, float, float]


def nav_sat_fix(message: Any) -> Fix | None:
    """sensor_msgs/NavSatFix; None where the receiver had no fix."""
    place = (message.latitude, message.longitude, message.altitude)
    if message.status.status == _NO_FIX or not all(map(isfinite, place[:2])):
        return None
    altitude_m = place[2] if isfinite(place[2]) else 0.0
    stamp = stamp_ns(message.header.stamp)
    return Fix(message.header.frame_id, stamp, place[0], place[1], altitude_m)


def imu(message: Any) -> Orientation | None:
    """sensor_msgs/Imu; None where it says that it knows no orientation."""
    if message.orientation_covariance[0] == -1:
        return None
    rotation = xyzw(message.orientation)
    return Orientation(message.header.frame_id, stamp_ns(message.header.stamp), rotation)


def east_north_up(fixes: FloatArray) -> FloatArray:
    """Places in the local frame at the first of them.

    Args:
        fixes: `(n, 3)` latitude and longitude in degrees, altitude in metres.

    Returns:
        `(n, 3)` metres east, north, up.
    """
    earth_m = _earth_centred(fixes)
    latitude, longitude = np.radians(fixes[0, :2])
    sin_lat, cos_lat = np.sin(latitude), np.cos(latitude)
    sin_lon, cos_lon = np.sin(longitude), np.cos(longitude)
    local_from_earth = np.array(
        [
            [-sin_lon, cos_lon, 0.0],
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        ]
    )
    local_m: FloatArray = (earth_m - earth_m[0]) @ local_from_earth.T
    return local_m


def _earth_centred(fixes: FloatArray) -> FloatArray:
    latitude, longitude = np.radians(fixes[:, 0]), np.radians(fixes[:, 1])
    radius_m = _SEMI_MAJOR_M / np.sqrt(1 - _ECCENTRICITY_2 * np.sin(latitude) ** 2)
    level_m = (radius_m + fixes[:, 2]) * np.cos(latitude)
    up_m = (radius_m * (1 - _ECCENTRICITY_2) + fixes[:, 2]) * np.sin(latitude)
    return np.column_stack([level_m * np.cos(longitude), level_m * np.sin(longitude), up_m])
