"""2D boxes of projected 3D boxes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hbbatch.boxes import FloatArray, corners
from hbbatch.projection import BREADTH, NEAR_PLANE_M, Camera, image_boxes
from hbbatch.sources.base import SourceOptions
from hbbatch.sources.kitti import KittiSource

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


def test_breadth_is_kept_about_the_middle() -> None:
    whole = seen((12.27, 0.06, -0.08, 4.0, 2.0, 1.5, 0.0))[0]
    rows = np.array([(12.27, 0.06, -0.08, 4.0, 2.0, 1.5, 0.0)] * 2)
    camera = Camera(IMAGE_FROM_SENSOR, WIDTH_PX, HEIGHT_PX)
    car, person = camera.outlines(rows, np.arange(2), ["car", "pedestrian"])
    np.testing.assert_allclose(car, whole)
    np.testing.assert_allclose(person[[1, 3]], whole[[1, 3]])
    np.testing.assert_allclose(person[[0, 2]].mean(), whole[[0, 2]].mean())
    width_px = (whole[2] - whole[0]) * BREADTH["pedestrian"]
    np.testing.assert_allclose(person[2] - person[0], width_px)


def labelled(test_data: Path) -> Iterator[tuple[str, float, float]]:
    """Class, widths and heights of labelled image boxes over those of the projected boxes."""
    detections = test_data / "kitti/detections/virconv/training"
    source = KittiSource(test_data / "kitti/training", SourceOptions(detections))
    for handle in source.sequences():
        if not (test_data / f"kitti/training/label_02/{handle.sequence_id}.txt").is_file():
            continue
        [reading] = handle.read()
        labels, calibration = reading.labels, reading.calibration
        assert labels is not None
        assert calibration is not None
        size_px = calibration.image_width_px, calibration.image_height_px
        hull = image_boxes(labels.boxes, calibration.image_from_sensor, *size_px)
        whole = (labels.truncation == 0) & (hull[:, 0] > 1) & (hull[:, 2] < size_px[0] - 2)
        whole &= labels.boxes[:, 0] > 5.0
        drawn = labels.image_boxes
        ratio = (drawn[:, 2:] - drawn[:, :2]) / (hull[:, 2:] - hull[:, :2])
        for row in np.flatnonzero(whole):
            yield labels.class_names[row], *ratio[row]


def test_breadths_are_those_of_labelled_objects(test_data: Path) -> None:
    ratios: dict[str, list[tuple[float, float]]] = {}
    for name, width, height in labelled(test_data):
        ratios.setdefault(name.lower(), []).append((width, height))
    for name in ("car", "van", "cyclist", "pedestrian"):
        width, height = np.mean(ratios[name], axis=0)
        assert abs(width - BREADTH.get(name, 1.0)) < 0.025, name
        assert abs(height - 1.0) < 0.025, name
