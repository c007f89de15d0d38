"""KITTI result files."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hbbatch import schema
from hbbatch.boxes import BOX_FIELDS, FloatArray, corners
from hbbatch.projection import Camera
from hbbatch.sinks.kitti import _Lines, kitti_result, kitti_type

CAMERA = Camera(np.array([[600.0, -700, 0, 0], [180.0, 0, -700, 0], [1.0, 0, 0, 0]]), 1242, 375)
"""At the sensor's origin, looking along its x axis."""
AHEAD = (20.0, 2.0, 0.0, 4.0, 1.8, 1.5, 0.3)
BEHIND = (-20.0, 2.0, 0.0, 4.0, 1.8, 1.5, 0.3)


def tracks(*boxes: tuple[float, ...], **values: Any) -> pa.Table:
    """A tracks table of boxes in the sensor frame, one frame after the other."""
    rows = [
        {
            "frame_index": frame,
            "timestamp_ns": 0,
            "track_id": 7,
            "class_name": "car",
            "state": "detected",
            "track_score": 0.875,
            **dict.fromkeys((*BOX_FIELDS, "velocity_x", "velocity_y", "velocity_z"), 0.0),
            **{f"sensor_{name}": value for name, value in zip(BOX_FIELDS, box, strict=True)},
            **values,
        }
        for frame, box in enumerate(boxes)
    ]
    return pa.Table.from_pylist(rows, schema=schema.TRACKS)


def lines(content: bytes) -> list[list[str]]:
    return [line.split(" ") for line in content.decode("ascii").splitlines()]


def test_a_line_holds_the_eighteen_columns_of_the_format() -> None:
    (line,) = lines(kitti_result(tracks(AHEAD), CAMERA))
    assert len(line) == 18
    assert line[:5] == ["0", "7", "Car", "-1", "-1"]
    height, width, length, x, y, z, rotation_y, score = map(float, line[10:])
    assert (height, width, length) == (1.5, 1.8, 4.0)
    assert (x, y, z) == (-2.0, 0.75, 20.0), "bottom centre: x right, y down, z forward"
    assert rotation_y == pytest.approx(-0.3 - np.pi / 2, abs=1e-4)
    assert float(line[5]) == pytest.approx(rotation_y - np.arctan2(-2, 20), abs=1e-4)
    assert score == 0.875


def test_pixels_are_those_of_the_projected_box() -> None:
    (line,) = lines(kitti_result(tracks(AHEAD), CAMERA))
    expected = CAMERA.outlines(np.array([AHEAD]), np.zeros(1, int), ["car"])[0]
    assert np.allclose([float(value) for value in line[6:10]], expected, atol=1e-4)


def test_a_pedestrian_is_narrower_than_the_box_around_it() -> None:
    (car,) = lines(kitti_result(tracks(AHEAD), CAMERA))
    person = tracks(AHEAD)
    names = pa.array(["pedestrian"], person["class_name"].type)
    person = person.set_column(person.column_names.index("class_name"), "class_name", names)
    (narrow,) = lines(kitti_result(person, CAMERA))
    wide_px, narrow_px = (float(line[8]) - float(line[6]) for line in (car, narrow))
    assert narrow_px == pytest.approx(0.81 * wide_px, abs=1e-3)
    assert narrow[7::2][:2] == car[7::2][:2]


def test_boxes_out_of_the_image_are_left_out() -> None:
    content = kitti_result(tracks(BEHIND, AHEAD, BEHIND), CAMERA)
    assert [line[0] for line in lines(content)] == ["1"]


def test_without_a_camera_all_boxes_are_written_without_pixels() -> None:
    content = kitti_result(tracks(BEHIND, AHEAD), None)
    assert [line[6:10] for line in lines(content)] == [["-1"] * 4] * 2


@pytest.mark.parametrize("camera", [CAMERA, None])
def test_no_track_is_no_byte(camera: Camera | None) -> None:
    assert kitti_result(tracks(), camera) == b""


def test_nothing_in_the_image_is_no_byte() -> None:
    assert kitti_result(tracks(BEHIND), CAMERA) == b""


@pytest.mark.parametrize(
    ("name", "spelled"),
    [
        ("car", "Car"),
        ("person_sitting", "Person_sitting"),
        ("dont_care", "DontCare"),
        ("traffic cone", "Traffic_cone"),
    ],
)
def test_classes_are_spelled_as_kitti_does_and_in_one_word(name: str, spelled: str) -> None:
    assert kitti_type(name) == spelled
    assert lines(kitti_result(tracks(AHEAD, class_name=name), CAMERA))[0][2] == spelled


def kitti_corners(line: list[str]) -> FloatArray:
    """Corners of a line's box in the sensor frame, computed by KITTI's own rule.

    `[x; y; z] + R_y(ry) [±l/2; 0 or -h; ±w/2]` in camera axes, as the devkit draws boxes.
    """
    height, width, length, x, y, z, rotation_y = map(float, line[10:17])
    along = length / 2 * np.array([1, 1, -1, -1, 1, 1, -1, -1])
    up = -height * np.array([0, 0, 0, 0, 1, 1, 1, 1])
    across = width / 2 * np.array([1, -1, -1, 1, 1, -1, -1, 1])
    cos, sin = np.cos(rotation_y), np.sin(rotation_y)
    camera = np.stack([x + cos * along + sin * across, y + up, z - sin * along + cos * across])
    return np.stack([camera[2], -camera[0], -camera[1]], axis=1)


@given(
    st.tuples(
        st.floats(-50, 50),
        st.floats(-50, 50),
        st.floats(-3, 3),
        st.floats(0.3, 20),
        st.floats(0.3, 4),
        st.floats(0.3, 4),
        st.floats(-10, 10),
    )
)
def test_the_box_is_where_kitti_puts_it_and_angles_are_wrapped(box: tuple[float, ...]) -> None:
    (line,) = lines(kitti_result(tracks(box), None))
    written, meant = kitti_corners(line), corners(np.array([box]))[0]
    distances = np.linalg.norm(written[:, None] - meant[None], axis=-1)
    assert distances.min(axis=1).max() < 5e-3
    front = (meant[0] + meant[1]) / 2
    assert np.linalg.norm((written[0] + written[1]) / 2 - front) < 5e-3, "heading, not its opposite"
    assert -3.1416 <= float(line[5]) <= 3.1416
    assert -3.1416 <= float(line[16]) <= 3.1416


NUMBERS = st.floats(-1e9, 1e9, exclude_min=True, exclude_max=True)
ROUND_ONES = st.builds(lambda units, by: units / by, st.integers(-(10**6), 10**6), st.just(1e4))
TIES = st.builds(lambda units: (units + 0.5) / 1e4, st.integers(-(10**6), 10**6))


def rows(values: list[float]) -> _Lines:
    """A line a value, of three classes."""
    number = np.arange(len(values))
    kinds = ["Car", "Person_sitting", "Vélo"]
    return _Lines(number, 10**number, number % 3, kinds, np.array([values, values[::-1]]))


@given(st.lists(NUMBERS | ROUND_ONES | TIES, min_size=1, max_size=18))
def test_compiled_text_is_that_of_arrow(kernels: ModuleType, values: list[float]) -> None:
    assert rows(values).compiled() == rows(values).text()


@pytest.mark.parametrize("value", [1e9, -1e9, 1e300, np.inf, -np.inf, np.nan])
def test_what_the_kernel_cannot_write_is_left_to_arrow(kernels: ModuleType, value: float) -> None:
    assert rows([1.0, value]).compiled() == b""
    (line, *_) = lines(kitti_result(tracks(AHEAD, track_score=value), CAMERA))
    assert float(line[17]) == pytest.approx(value, nan_ok=True)


def test_what_does_not_fit_is_refused(kernels: ModuleType) -> None:
    number, values = np.arange(3), np.ones((2, 3))
    right = [number, number, number, b"abc", np.arange(4), values, np.empty(300, np.uint8)]
    assert kernels.lines(*right) > 0
    wrong = {
        0: [np.arange(2), number.astype(float)],
        1: [np.arange(4)],
        2: [number + 1, number - 1, np.full(3, 2**62)],
        3: [b"ab", "abc", np.arange(3)],
        4: [np.arange(3), np.array([0, 2, 1, 3]), np.array([-1, 1, 2, 3]), np.empty(0, int)],
        5: [np.ones((2, 4)), np.ones(3), np.ones((2, 3), np.float32)],
        6: [np.empty(200, np.uint8), bytes(300)],
    }
    for place, several in wrong.items():
        for value in several:
            with pytest.raises((ValueError, TypeError, BufferError)):
                kernels.lines(*right[:place], value, *right[place + 1 :])
