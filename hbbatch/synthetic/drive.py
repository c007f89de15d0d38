"""A whole drive: everybody's motion, what the sensor saw of it, what the detector made of that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hbbatch.boxes import BOX_SIZE, HEIGHT, LENGTH, YAW, FloatArray, Z
from hbbatch.synthetic.city import City, make_city
from hbbatch.synthetic.detector import Detections, Detector, clutter_sizes, false_classes
from hbbatch.synthetic.populate import populate
from hbbatch.synthetic.sensor import Pose, View, sensor_pose, view
from hbbatch.synthetic.settings import DriveSettings
from hbbatch.synthetic.traffic import TrafficHistory, simulate_traffic

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class DriveFrame:
    """One frame of a drive.

    Attributes:
        timestamp_ns: since the Unix epoch.
        pose: of the sensor, true.
        logged_pose: of the sensor, as the vehicle believes it to be.
        speed_m_s: of the ego vehicle.
        yaw_rate_rad_s: of the ego vehicle.
        object_boxes: `(objects, 7)` true boxes, world frame, without the ego vehicle.
        object_speed_m_s: `(objects,)`.
        seen: the same objects as the sensor has them before it.
        detections: what the detector said.
    """

    timestamp_ns: int
    pose: Pose
    logged_pose: Pose
    speed_m_s: float
    yaw_rate_rad_s: float
    object_boxes: FloatArray
    object_speed_m_s: FloatArray
    seen: View
    detections: Detections


@dataclass(frozen=True)
class Drive:
    """A simulated drive; object i keeps its row i in every frame.

    Attributes:
        settings: what it was made from.
        class_codes: `(objects,)` index into `settings.CLASS_NAMES`.
        frames: in time order.
    """

    settings: DriveSettings
    class_codes: IntArray
    frames: list[DriveFrame]


def simulate_drive(settings: DriveSettings, seed: int) -> Drive:
    """A drive; the same settings and seed give the same drive."""
    traffic_rng, detector_rng, pose_rng = np.random.default_rng(seed).spawn(3)
    city = make_city(settings.traffic, traffic_rng)
    population = populate(city, settings.traffic, settings.duration_s, traffic_rng)
    history = simulate_traffic(
        city, population, settings.frame_count, 1 / settings.rate_hz, traffic_rng
    )
    return _drive_through(settings, city, history, detector_rng, pose_rng)


def _drive_through(
    settings: DriveSettings,
    city: City,
    history: TrafficHistory,
    detector_rng: np.random.Generator,
    pose_rng: np.random.Generator,
) -> Drive:
    class_codes = history.class_codes[1:]
    step_s = 1 / settings.rate_hz
    detector = Detector(settings.detector, settings.sensor, class_codes, step_s, detector_rng)
    places, place_codes = _clutter_places(city, settings, detector_rng)
    houses = city.house_blocks()
    yaw_rate = np.gradient(np.unwrap(history.boxes[:, 0, YAW]), step_s)
    frames = []
    for index, boxes in enumerate(history.boxes):
        pose = sensor_pose(boxes[0], city, settings.sensor)
        # Clutter hides nothing, so objects are looked at without it.
        seen = view(boxes[1:], pose, houses, settings.sensor)
        mistakable = view(places, pose, houses, settings.sensor)
        frames.append(
            DriveFrame(
                timestamp_ns=settings.start_ns + round(index * step_s * 1e9),
                pose=pose,
                logged_pose=_logged(pose, settings, pose_rng),
                speed_m_s=float(history.speed_m_s[index, 0]),
                yaw_rate_rad_s=float(yaw_rate[index]),
                object_boxes=boxes[1:],
                object_speed_m_s=history.speed_m_s[index, 1:],
                seen=seen,
                detections=detector.detect(seen, mistakable, place_codes),
            )
        )
    return Drive(settings, class_codes, frames)


def _clutter_places(
    city: City, settings: DriveSettings, rng: np.random.Generator
) -> tuple[FloatArray, IntArray]:
    """Boxes `(n, 7)` beside the streets that may be mistaken for an object, and for which."""
    count = settings.detector.clutter
    codes = false_classes(count, rng)
    along = rng.uniform(0, city.extent_m, count)
    middle = rng.integers(0, city.settings.blocks + 1, count) * city.settings.block_length_m
    aside = rng.choice([-1.0, 1.0], count) * (city.pavement_m + rng.uniform(-1.0, 1.5, count))
    plan = np.stack([along, middle + aside], axis=1)
    turned = rng.random(count) < 0.5
    plan[turned] = plan[turned][:, ::-1]
    boxes = np.zeros((count, BOX_SIZE))
    boxes[:, :2] = city.to_world(plan)
    boxes[:, LENGTH : HEIGHT + 1] = clutter_sizes(codes)
    boxes[:, Z] = city.ground_m(boxes[:, :2]) + boxes[:, HEIGHT] / 2
    boxes[:, YAW] = rng.uniform(-np.pi, np.pi, count)
    return boxes, codes


def _logged(pose: Pose, settings: DriveSettings, rng: np.random.Generator) -> Pose:
    sensor = settings.sensor
    turn = Rotation.from_euler("z", rng.normal(0, sensor.pose_noise_rad)).as_matrix()
    shift = rng.normal(0, sensor.pose_noise_m, 3)
    return Pose(pose.rotation @ turn, pose.translation_m + shift)
