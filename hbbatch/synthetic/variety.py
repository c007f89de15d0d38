"""Drives that differ: detectors of all qualities, sensors, streets and traffic, drawn by chance.

Ranges are wide enough to hold the detectors of docs/synthetic.md with room on both sides.
"""

from __future__ import annotations

import math

import numpy as np

from hbbatch.synthetic.settings import (
    DetectorSettings,
    DriveSettings,
    SensorSettings,
    TrafficSettings,
)

_RATES_HZ = (10.0, 20.0, 5.0)
_RATE_SHARES = (0.7, 0.2, 0.1)
_FIELDS_OF_VIEW_RAD = (2 * math.pi, math.pi / 2)


def varied_settings(rng: np.random.Generator, duration_s: float) -> DriveSettings:
    """Settings of one drive, unlike those of others."""
    return DriveSettings(
        duration_s=duration_s,
        rate_hz=float(rng.choice(_RATES_HZ, p=_RATE_SHARES)),
        traffic=_traffic(rng),
        sensor=_sensor(rng),
        detector=_detector(rng),
    )


def _traffic(rng: np.random.Generator) -> TrafficSettings:
    usual = TrafficSettings()
    block_length_m = rng.uniform(80.0, 200.0)
    streets = 2 * usual.blocks * (usual.blocks + 1)
    street_hm = streets * block_length_m / 100.0

    def along_streets(fewest: float, most: float) -> int:
        """How many there are of something of which so many stand or move in 100 m of street."""
        return round(street_hm * rng.uniform(fewest, most))

    return TrafficSettings(
        block_length_m=block_length_m,
        lanes=int(rng.integers(1, 3)),
        bend_m=rng.uniform(0.0, 8.0),
        house_setback_m=rng.uniform(2.0, 20.0),
        hill_m=rng.uniform(0.0, 2.5),
        speed_limit_m_s=rng.uniform(9.0, 22.0),
        moving_vehicles=along_streets(1.5, 3.5),
        truck_share=rng.uniform(0.02, 0.15),
        parked_vehicles=along_streets(0.5, 6.0),
        cyclists=along_streets(0.5, 1.0),
        pedestrians=along_streets(1.0, 4.0),
    )


def _sensor(rng: np.random.Generator) -> SensorSettings:
    return SensorSettings(
        range_m=rng.uniform(60.0, 100.0),
        field_of_view_rad=float(rng.choice(_FIELDS_OF_VIEW_RAD)),
        points_at_10_m=_between(120.0, 400.0, rng),
        pose_noise_m=_between(0.003, 0.02, rng),
        pose_noise_rad=_between(0.0001, 0.001, rng),
    )


def _detector(rng: np.random.Generator) -> DetectorSettings:
    position_noise_m = _between(0.02, 0.06, rng)
    return DetectorSettings(
        max_recall=rng.uniform(0.93, 0.995),
        points_for_half=_between(5.0, 25.0, rng),
        position_noise_m=position_noise_m,
        noise_doubling_m=rng.uniform(30.0, 50.0),
        new_share=rng.uniform(0.2, 0.4),
        lasting_share=rng.uniform(0.25, 0.5),
        drift_s=rng.uniform(0.3, 0.9),
        lasting_s=rng.uniform(2.0, 6.0),
        spread=rng.uniform(0.3, 0.8),
        size_noise=position_noise_m * rng.uniform(0.6, 1.2),
        yaw_noise_rad=position_noise_m * rng.uniform(0.3, 0.7),
        flip_share=rng.uniform(0.0, 0.07),
    )


def _between(low: float, high: float, rng: np.random.Generator) -> float:
    """A number drawn evenly on a logarithmic scale."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))
