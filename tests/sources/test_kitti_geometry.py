"""The box conversion held against KITTI's own definition of a box's corners."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hbbatch.boxes import corners
from hbbatch.sources.kitti_geometry import sensor_boxes

_METRES = st.floats(-100, 100)
_SIZES = st.floats(0.1, 20)
_ANGLES = st.floats(-10, 10)


@given(st.tuples(_SIZES, _SIZES, _SIZES, _METRES, _METRES, _METRES, _ANGLES))
def test_corners_are_those_of_the_development_kit(box: tuple[float, ...]) -> None:
    height, width, length, x, y, z, ry = box
    along = length / 2 * np.array([1, 1, -1, -1, 1, 1, -1, -1])
    up = -height * np.array([0, 0, 0, 0, 1, 1, 1, 1])
    across = width / 2 * np.array([1, -1, -1, 1, 1, -1, -1, 1])
    camera = np.stack(
        [
            np.cos(ry) * along + np.sin(ry) * across + x,
            up + y,
            -np.sin(ry) * along + np.cos(ry) * across + z,
        ],
        axis=1,
    )
    expected = np.stack([camera[:, 2], -camera[:, 0], -camera[:, 1]], axis=1)
    [ours] = corners(sensor_boxes(np.array([box])))
    distances = np.linalg.norm(ours[:, None] - expected[None], axis=2)
    assert distances.min(axis=1).max() < 1e-9
    assert distances.min(axis=0).max() < 1e-9


@given(_ANGLES)
def test_heading_is_kittis(ry: float) -> None:
    yaw = sensor_boxes(np.array([[1.5, 1.6, 4.0, 0, 0, 0, ry]]))[0, 6]
    camera_heading = np.array([np.cos(ry), 0.0, -np.sin(ry)])
    np.testing.assert_allclose(
        [np.cos(yaw), np.sin(yaw)], [camera_heading[2], -camera_heading[0]], atol=1e-12
    )
    assert -np.pi <= yaw < np.pi
