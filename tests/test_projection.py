"""2D boxes of projected 3D boxes."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hbbatch.boxes import FloatArray, corners
from hbbatch.projection import NEAR_PLANE_M, image_boxes

WIDTH_PX, HEIGHT_PX = 1242, 375
IMAGE_FROM_CAMERA = np.array([[720.0, 0, 610], [0, 720, 173], [0, 0, 1]])
CAMERA_FROM_SENSOR = np.array([[0.0, -1, 0, 0.06], [0, 0, -1, -0.08], [1, 0, 0, -0.27]])
IMAGE_FROM_SENSOR = IMAGE_FROM_CAMERA @ CAMERA_FROM_SENSOR


def seen(*boxes: tuple[float, ...]) -> FloatArray:
    rows = np.array(boxes, dtype=float).reshape(-1, 7)
    return image_boxes(rows, IMAGE_FROM_SENSOR, WIDTH_PX, HEIGHT_PX)


def test_a_box_straight_ahead_is_centred_and_sized_by_its_near_face() -> None:
    left, top, right, bottom = seen((12.27, 0.06, -0.08, 4.0, 2.0, 1.5, 0.0))[0]
    assert np.allclose([left, right], [610 - 72, 610 + 72])
    assert np.allclose([top, bottom], [173 - 54, 173 + 54])


def test_boxes_behind_and_beside_the_camera_are_nan() -> None:
    assert np.isnan(seen((-10, 0, 0, 4, 2, 1.5, 0), (10, 60, 0, 4, 2, 1.5, 0))).all()


def test_a_box_the_camera_stands_beside_reaches_the_edge_of_the_image() -> None:
    left, _, right, bottom = seen((1.0, -1.5, -0.5, 6.0, 1.0, 1.5, 0.0))[0]
    assert left > WIDTH_PX / 2
    assert right == WIDTH_PX - 1
    assert bottom == HEIGHT_PX - 1


def test_no_boxes_give_no_rows() -> None:
    assert seen().shape == (0, 4)


def sampled(box: FloatArray) -> FloatArray:
    """The rectangle around many points on the edges of a box, those in front of the near plane."""
    eight = corners(box[None])[0]
    share = np.linspace(0, 1, 2001)[:, None]
    points = np.concatenate(
        [eight[i] + share * (eight[j] - eight[i]) for i in range(8) for j in range(i)]
    )
    projected = points @ IMAGE_FROM_SENSOR[:, :3].T + IMAGE_FROM_SENSOR[:, 3]
    projected = projected[projected[:, 2] >= NEAR_PLANE_M]
    if not len(projected):
        return np.full(4, np.nan)
    pixels = projected[:, :2] / projected[:, 2:]
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])


@given(
    st.tuples(
        st.floats(-3, 30),
        st.floats(-8, 8),
        st.floats(-2, 1),
        st.floats(0.5, 8),
        st.floats(0.5, 3),
        st.floats(0.5, 3),
        st.floats(-4, 4),
    )
)
def test_the_rectangle_holds_every_visible_point_and_is_tight(box: tuple[float, ...]) -> None:
    huge_px = 1e7
    dense = sampled(np.array(box))
    exact = image_boxes(np.array([box]), IMAGE_FROM_SENSOR, huge_px, huge_px)[0]
    inside = np.clip(dense, 0, huge_px - 1)
    if np.isnan(dense).any() or (inside[:2] >= inside[2:]).any():
        return
    assert (exact[:2] <= inside[:2] + 1e-6).all()
    assert (exact[2:] >= inside[2:] - 1e-6).all()
    size = np.maximum(exact[2:] - exact[:2], 1)
    assert (np.abs(exact - inside) / np.tile(size, 2) < 0.2).all()
