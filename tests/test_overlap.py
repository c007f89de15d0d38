"""Footprint intersection against shapely, and the overlaps built on it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import Polygon

from hbbatch.boxes import corners
from hbbatch.overlap import footprint_intersection, iou_3d, iou_bev

METRES = st.floats(-8, 8)
SIZE = st.floats(0.05, 12)
ANGLE = st.one_of(
    st.floats(-7, 7), st.sampled_from([0.0, np.pi / 2, np.pi, -np.pi / 2, 2 * np.pi, np.pi / 4])
)
BOX = st.tuples(METRES, METRES, METRES, SIZE, SIZE, SIZE, ANGLE)


def polygon(box: np.ndarray) -> Polygon:
    return Polygon(corners(box[None])[0, :4, :2])


@given(BOX, BOX)
def test_footprint_intersection_agrees_with_shapely(first: tuple, second: tuple) -> None:
    a, b = np.array(first), np.array(second)
    expected = polygon(a).intersection(polygon(b)).area
    assert footprint_intersection(a[None], b[None])[0] == pytest.approx(expected, abs=1e-6)


@given(BOX, st.sampled_from([0.0, np.pi / 2, np.pi, -np.pi / 2]), st.floats(1.0, 1.0001))
def test_coinciding_edges_are_counted_once(box: tuple, turn: float, growth: float) -> None:
    a = np.array(box)
    b = a.copy()
    b[6] += turn
    b[3:5] *= growth
    expected = polygon(a).intersection(polygon(b)).area
    assert footprint_intersection(a[None], b[None])[0] == pytest.approx(expected, abs=1e-5)


@given(BOX, BOX)
def test_intersection_is_symmetric(first: tuple, second: tuple) -> None:
    a, b = np.array([first]), np.array([second])
    assert footprint_intersection(a, b) == pytest.approx(footprint_intersection(b, a), abs=1e-6)


def test_boxes_that_touch_share_nothing() -> None:
    a = np.array([[0.0, 0, 0, 4, 2, 1, 0]])
    b = np.array([[4.0, 0, 0, 4, 2, 1, 0]])
    assert footprint_intersection(a, b)[0] == pytest.approx(0.0, abs=1e-6)


def test_iou_of_boxes_half_overlapping_along_their_length() -> None:
    a = np.array([[0.0, 0, 0, 4, 2, 1, 0.3]])
    b = a.copy()
    b[0, :2] += 2 * np.cos(0.3), 2 * np.sin(0.3)
    assert iou_bev(a, b)[0] == pytest.approx(1 / 3)
    assert iou_3d(a, b)[0] == pytest.approx(1 / 3)
    b[0, 2] += 0.5
    assert iou_3d(a, b)[0] == pytest.approx(0.25 / 1.75)
