"""What a simulated drive is made of. Vary these to make other cities, sensors and detectors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

CAR, TRUCK, CYCLIST, PEDESTRIAN = range(4)
CLASS_NAMES: Final = ("car", "truck", "cyclist", "pedestrian")


@dataclass(frozen=True)
class TrafficSettings:
    """A square of streets crossing at right angles, bent, with signals at every junction.

    Attributes:
        blocks: city blocks along each side of the square.
        block_length_m: distance between junctions.
        lanes: lanes in each direction.
        bend_m: how far streets swing to either side of a straight line.
        house_setback_m: from the pavement to the houses, which hide what is behind them.
        hill_m: how far the ground rises and falls about its mean.
        speed_limit_m_s: what drivers want to drive, give or take.
        moving_vehicles: cars and trucks in traffic, without the ego vehicle.
        truck_share: share of trucks among moving and parked vehicles.
        parked_vehicles: at the kerb; one in twenty stands in the lane and must be overtaken.
        cyclists: at the right of the right lane.
        pedestrians: on pavements, crossing now and then.
    """

    blocks: int = 3
    block_length_m: float = 90.0
    lanes: int = 1
    bend_m: float = 5.0
    house_setback_m: float = 8.0
    hill_m: float = 0.5
    speed_limit_m_s: float = 12.0
    moving_vehicles: int = 40
    truck_share: float = 0.06
    parked_vehicles: int = 100
    cyclists: int = 12
    pedestrians: int = 50


@dataclass(frozen=True)
class SensorSettings:
    """A lidar on the roof of the ego vehicle, looking ahead when its field of view is narrow.

    Attributes:
        range_m: farther objects are not seen.
        field_of_view_rad: horizontal, centred on the vehicle's heading.
        height_m: above the ground.
        points_at_10_m: lidar points on a square metre at a distance of 10 m.
        pose_noise_m: standard deviation of the logged position, each axis.
        pose_noise_rad: standard deviation of the logged heading.
    """

    range_m: float = 75.0
    field_of_view_rad: float = 6.283185307179586
    height_m: float = 1.8
    points_at_10_m: float = 250.0
    pose_noise_m: float = 0.01
    pose_noise_rad: float = 0.0005


@dataclass(frozen=True)
class DetectorSettings:
    """How good the 3D detector is.

    Errors of a box have three parts: one new in every frame, one that drifts within a second, one
    that lasts for seconds; `new_share` and `lasting_share` of the variance are the first and last.
    All of it grows with the square of the range and with what is hidden, and by the object's
    spread, which itself comes and goes.

    Attributes:
        max_recall: share of objects found when they are near and in full view.
        points_for_half: lidar points on an object at which half of such objects are found.
        position_noise_m: standard deviation of a car's centre across its heading, at range 0.
        noise_doubling_m: range at which noise has doubled.
        new_share: share of the errors' variance that is new in every frame.
        lasting_share: share of the errors' variance that lasts.
        drift_s: time constant of what drifts.
        lasting_s: time constant of what lasts: such errors, misses, flips, the spread.
        spread: standard deviation of the logarithm of an object's noise about what is usual.
        size_noise: relative standard deviation of a car's sizes at range 0, half of its variance
            constant for an object.
        yaw_noise_rad: standard deviation of a car's heading at range 0.
        flip_share: share of boxes that point backwards.
        duplicate_share: share of objects that get a second box.
        transient_per_frame: mean number of false boxes that come and go.
        clutter: places that look like an object now and then.
        clutter_share: share of frames in which such a place is detected.
    """

    max_recall: float = 0.97
    points_for_half: float = 14.0
    position_noise_m: float = 0.035
    noise_doubling_m: float = 38.0
    new_share: float = 0.3
    lasting_share: float = 0.35
    drift_s: float = 0.6
    lasting_s: float = 4.0
    spread: float = 0.5
    size_noise: float = 0.03
    yaw_noise_rad: float = 0.016
    flip_share: float = 0.03
    duplicate_share: float = 0.01
    transient_per_frame: float = 0.4
    clutter: int = 40
    clutter_share: float = 0.1


@dataclass(frozen=True)
class DriveSettings:
    """One simulated drive.

    Attributes:
        duration_s: length of the drive.
        rate_hz: frames a second.
        start_ns: time of the first frame, since the Unix epoch.
    """

    duration_s: float = 40.0
    rate_hz: float = 10.0
    start_ns: int = 1_750_000_000_000_000_000
    traffic: TrafficSettings = TrafficSettings()
    sensor: SensorSettings = SensorSettings()
    detector: DetectorSettings = DetectorSettings()

    @property
    def frame_count(self) -> int:
        """Frames of the drive."""
        return round(self.duration_s * self.rate_hz)
