"""What stands in the way cannot be seen through."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hbbatch.synthetic.sensor import Pose, View, view
from hbbatch.synthetic.settings import SensorSettings

HEIGHT_M = 1.8
LEVEL = Pose(np.eye(3), np.array([0.0, 0.0, HEIGHT_M]))
NO_HOUSES = np.zeros((0, 4, 2))


def car(x: float, y: float = 0.0, yaw: float = 0.0) -> list[float]:
    return [x, y, 0.75, 4.4, 1.8, 1.5, yaw]


def look(boxes: list[list[float]], houses: np.ndarray = NO_HOUSES, **limits: float) -> View:
    return view(np.array(boxes), LEVEL, houses, SensorSettings(**limits))


def test_an_object_alone_is_seen_whole() -> None:
    seen = look([car(20.0)])
    assert seen.visible[0] == 1.0
    assert seen.range_m[0] == pytest.approx(20.0)
    assert seen.boxes[0, 2] == pytest.approx(0.75 - HEIGHT_M)


def test_a_truck_hides_the_car_behind_it_but_not_the_one_beside() -> None:
    truck = [15.0, 0.0, 1.6, 8.0, 2.5, 3.2, 0.0]
    behind, half_behind, beside = car(30.0), car(30.0, 3.0), car(30.0, 12.0)
    seen = look([behind, half_behind, beside, truck])
    assert seen.visible[0] == 0.0
    assert 0.2 < seen.visible[1] < 0.95
    assert seen.visible[2] == seen.visible[3] == 1.0


def test_a_low_object_leaves_the_top_of_a_high_one_in_view() -> None:
    bus = [30.0, 0.0, 1.6, 10.0, 2.5, 3.2, 0.0]
    seen = look([bus, car(12.0)])
    assert 0.2 < seen.visible[0] < 0.9


def test_houses_hide_what_is_behind_them() -> None:
    house = np.array([[[10.0, -5.0], [14.0, -5.0], [14.0, 5.0], [10.0, 5.0]]])
    seen = look([car(30.0), car(30.0, 30.0)], house)
    assert seen.visible.tolist() == [0.0, 1.0]


def test_range_and_field_of_view_bound_what_is_seen() -> None:
    boxes = [car(20.0), car(-20.0), car(0.0, 20.0), car(80.0)]
    seen = look(boxes, range_m=75.0, field_of_view_rad=math.pi / 2)
    assert seen.visible.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert look(boxes, range_m=75.0).visible.tolist() == [1.0, 1.0, 1.0, 0.0]


def test_points_fall_with_the_square_of_the_range_and_grow_with_the_face() -> None:
    seen = look([car(20.0), car(40.0, 0.1), car(0.0, 20.0)])
    assert seen.points[0] / look([car(40.0)]).points[0] == pytest.approx(4.0)
    assert seen.points[2] / seen.points[0] == pytest.approx(4.4 / 1.8)


def test_the_pose_moves_and_turns_the_view() -> None:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    pose = Pose(quarter, np.array([5.0, 5.0, HEIGHT_M]))
    seen = view(np.array([car(5.0, 25.0, math.pi / 2)]), pose, NO_HOUSES, SensorSettings())
    np.testing.assert_allclose(seen.boxes[0, [0, 1, 6]], [20.0, 0.0, 0.0], atol=1e-12)
