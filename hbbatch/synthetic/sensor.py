"""What a lidar on the ego vehicle could see of everybody else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import HEIGHT, LENGTH, WIDTH, YAW, FloatArray, Z, corners, transform_boxes
from hbbatch.synthetic.city import City
from hbbatch.synthetic.settings import SensorSettings

_AZIMUTH_BINS: Final = 1440


@dataclass(frozen=True)
class Pose:
    """world_from_sensor: rotation `(3, 3)` and translation `(3,)` in metres."""

    rotation: FloatArray
    translation_m: FloatArray

    def to_sensor(self, boxes_world: FloatArray) -> FloatArray:
        """Boxes `(n, 7)` of the world frame in the sensor frame."""
        back = self.rotation.T
        return transform_boxes(boxes_world, back, -back @ self.translation_m)


@dataclass(frozen=True)
class View:
    """Objects as the sensor has them before it, `(n,)` each.

    Attributes:
        boxes: `(n, 7)` in the sensor frame.
        range_m: horizontal distance.
        visible: share of the object that nothing hides, 0..1; 0 outside range and field of view.
        points: lidar points expected on it.
    """

    boxes: FloatArray
    range_m: FloatArray
    visible: FloatArray
    points: FloatArray


def sensor_pose(ego_box: FloatArray, city: City, sensor: SensorSettings) -> Pose:
    """Where the sensor is: above the middle of the ego vehicle, tilted as the ground is."""
    at = ego_box[None, :2]
    slope_x, slope_y = city.ground_slope(at)[0]
    up = np.array([-slope_x, -slope_y, 1.0])
    up /= np.linalg.norm(up)
    ahead = np.array([np.cos(ego_box[YAW]), np.sin(ego_box[YAW]), 0.0])
    ahead -= (ahead @ up) * up
    ahead /= np.linalg.norm(ahead)
    rotation = np.stack([ahead, np.cross(up, ahead), up], axis=1)
    ground = np.array([*at[0], city.ground_m(at)[0]])
    return Pose(rotation, ground + sensor.height_m * up)


def view(boxes_world: FloatArray, pose: Pose, houses: FloatArray, sensor: SensorSettings) -> View:
    """How much of each object the sensor sees.

    Objects hide what is behind them by their angular outline: azimuth by azimuth, from the nearest
    to the farthest, as high as the horizon that nearer objects make. Houses hide by lines of sight.

    Args:
        boxes_world: `(n, 7)`.
        pose: of the sensor.
        houses: `(m, 4, 2)` corners of blocks of houses, world.
        sensor: its limits.
    """
    boxes = pose.to_sensor(boxes_world)
    range_m = np.hypot(boxes[:, 0], boxes[:, 1])
    azimuth = np.arctan2(boxes[:, 1], boxes[:, 0])
    in_reach = (range_m <= sensor.range_m) & (np.abs(azimuth) <= sensor.field_of_view_rad / 2)
    visible = np.zeros(len(boxes))
    near = np.flatnonzero(range_m <= sensor.range_m)
    visible[near] = _unhidden(boxes[near]) * _past_houses(boxes_world[near], pose, houses)
    visible[~in_reach] = 0.0
    points = sensor.points_at_10_m * (10.0 / np.maximum(range_m, 3.0)) ** 2
    return View(boxes, range_m, visible, points * visible * _face_m2(boxes, azimuth))


def _face_m2(boxes: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Area of each box that faces the sensor."""
    turn = boxes[:, YAW] - azimuth
    wide = boxes[:, LENGTH] * np.abs(np.sin(turn)) + boxes[:, WIDTH] * np.abs(np.cos(turn))
    face: FloatArray = wide * boxes[:, HEIGHT]
    return face


def _unhidden(boxes: FloatArray) -> FloatArray:
    """Share of each object's outline that no nearer object covers, `(n,)`."""
    ground = corners(boxes)[:, :4, :2]
    distance = np.linalg.norm(ground, axis=2).min(axis=1)
    centre = np.arctan2(boxes[:, 1], boxes[:, 0])
    spread = np.arctan2(ground[..., 1], ground[..., 0]) - centre[:, None]
    spread = (spread + np.pi) % (2 * np.pi) - np.pi
    first = np.floor((centre + spread.min(1)) / (2 * np.pi) * _AZIMUTH_BINS).astype(int)
    last = np.floor((centre + spread.max(1)) / (2 * np.pi) * _AZIMUTH_BINS).astype(int)
    top = np.arctan2(boxes[:, Z] + boxes[:, HEIGHT] / 2, distance)
    bottom = np.arctan2(boxes[:, Z] - boxes[:, HEIGHT] / 2, distance)
    horizon = np.full(_AZIMUTH_BINS, -np.pi)
    seen = np.ones(len(boxes))
    for i in np.argsort(distance):
        bins = np.arange(first[i], last[i] + 1) % _AZIMUTH_BINS
        covered = (horizon[bins] - bottom[i]) / max(top[i] - bottom[i], 1e-6)
        seen[i] = 1.0 - np.clip(covered, 0.0, 1.0).mean()
        horizon[bins] = np.maximum(horizon[bins], top[i])
    return seen


def _past_houses(boxes_world: FloatArray, pose: Pose, houses: FloatArray) -> FloatArray:
    """Share of lines of sight to centre and corners of each footprint that miss all houses."""
    targets = np.concatenate([boxes_world[:, None, :2], corners(boxes_world)[:, :4, :2]], axis=1)
    start = pose.translation_m[:2]
    walls_a, walls_b = houses.reshape(-1, 2), np.roll(houses, -1, axis=1).reshape(-1, 2)
    hit = _segments_cross(start, targets[:, :, None], walls_a, walls_b)
    free: FloatArray = 1.0 - hit.any(axis=2).mean(axis=1)
    return free


def _segments_cross(
    a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray
) -> NDArray[np.bool_]:
    """Whether segments a-b and c-d cross; arrays `(..., 2)` broadcast."""
    crosses = (_side(a, b, c) * _side(a, b, d) < 0) & (_side(c, d, a) * _side(c, d, b) < 0)
    return np.asarray(crosses)


def _side(a: FloatArray, b: FloatArray, point: FloatArray) -> FloatArray:
    ab, ap = b - a, point - a
    side: FloatArray = ab[..., 0] * ap[..., 1] - ab[..., 1] * ap[..., 0]
    return side
