"""Rotations against scipy's, and what a box is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hbbatch.boxes import (
    LARGEST,
    FloatArray,
    are_boxes,
    corners,
    rotation_matrices,
    transform_boxes,
)


def test_rotation_matrices_of_quaternions_of_any_length() -> None:
    quaternions = np.random.default_rng(0).normal(size=(50, 4))
    expected = Rotation.from_quat(quaternions).as_matrix()
    assert rotation_matrices(quaternions) == pytest.approx(expected, abs=1e-12)
    assert rotation_matrices(quaternions[:0]).shape == (0, 3, 3)


def random_boxes(seed: int, count: int = 20) -> FloatArray:
    random = np.random.default_rng(seed)
    sizes = random.uniform(0.3, 12, (count, 3))
    yaw = random.uniform(-np.pi, np.pi, (count, 1))
    return np.hstack([random.normal(scale=50, size=(count, 3)), sizes, yaw])


@given(st.integers(0, 10_000), st.floats(-3.1, 3.1))
def test_boxes_come_back_from_another_frame(seed: int, yaw: float) -> None:
    boxes = random_boxes(seed)
    rotation = Rotation.from_euler("z", yaw).as_matrix()
    translation = np.random.default_rng(seed).normal(scale=1000, size=3)
    there = transform_boxes(boxes, rotation, translation)
    back = transform_boxes(there, rotation.T, -rotation.T @ translation)
    assert back[:, :6] == pytest.approx(boxes[:, :6], abs=1e-9)
    assert np.cos(back[:, 6] - boxes[:, 6]) == pytest.approx(1)


def test_corners_are_those_of_a_plain_loop() -> None:
    boxes = random_boxes(1)
    for box, found in zip(boxes, corners(boxes), strict=True):
        turn = Rotation.from_euler("z", box[6])
        half = box[3:6] / 2
        expected = [
            box[:3] + turn.apply(half * (front, left, up))
            for up in (-1, 1)
            for front in (1, -1)
            for left in (1, -1)
        ]
        assert sorted(map(tuple, found.round(6))) == sorted(map(tuple, np.round(expected, 6)))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, -1.001 * LARGEST])
@pytest.mark.parametrize("column", range(7))
def test_what_is_not_finite_or_absurd_is_no_box(column: int, value: float) -> None:
    boxes = random_boxes(0, count=3)
    boxes[1, column] = value
    assert are_boxes(boxes).tolist() == [True, False, True]


@pytest.mark.parametrize("value", [0.0, -1.0])
@pytest.mark.parametrize("column", [3, 4, 5])
def test_what_has_no_size_is_no_box(column: int, value: float) -> None:
    boxes = random_boxes(0, count=3)
    boxes[1, column] = value
    assert are_boxes(boxes).tolist() == [True, False, True]
