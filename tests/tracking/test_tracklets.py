"""Labelled objects and the detections matched to them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from hbbatch import schema
from hbbatch.tracking.tracklets import join, trajectories
from tests.tracking.drives import car, sequence
from tests.tracking.real_drives import real_dataset, real_frames


def labels(rows: list[tuple[int, int, list[float]]], class_name: str = "car") -> pa.Table:
    """From (frame, object, box)."""
    columns: dict[str, list[object]] = {
        "frame_index": [frame for frame, _, _ in rows],
        "timestamp_ns": [frame * 10**8 for frame, _, _ in rows],
        "object_id": [number for _, number, _ in rows],
        "class_name": [class_name] * len(rows),
        "class_name_logged": [class_name] * len(rows),
        "frame_id": ["sensor"] * len(rows),
        "truncation": [0.0] * len(rows),
        "occlusion": [0] * len(rows),
    }
    names = ("x", "y", "z", "length", "width", "height", "yaw")
    columns |= {name: [box[i] for _, _, box in rows] for i, name in enumerate(names)}
    return schema.conform(pa.table(columns), schema.LABELS, "test")


def test_detections_are_matched_frame_by_frame() -> None:
    frames = sequence([[car(0.2), car(30)], [], [car(2.1)]])
    table = labels([(t, 7, car(1.0 * t)) for t in range(3)])
    found = trajectories(table, frames, ["car"], {"car": 0})
    assert found.seen.tolist() == [True, False, True]
    assert found.measured[[0, 2], 0].tolist() == [0.2, 2.1]
    assert found.truth[:, 0].tolist() == [0.0, 1.0, 2.0]
    assert found.dt_s == pytest.approx([0.0, 0.1, 0.1])


def test_an_object_that_comes_back_is_two_trajectories() -> None:
    table = labels([(0, 1, car(0)), (1, 1, car(0)), (3, 1, car(0)), (0, 2, car(20))])
    found = trajectories(table, sequence([[]] * 4), ["car"], {"car": 0})
    assert found.length.tolist() == [2, 1, 1]
    assert found.first_row.tolist() == [0, 2, 3]


def test_joined_trajectories_keep_their_rows_together() -> None:
    one = trajectories(
        labels([(0, 1, car(0)), (1, 1, car(1))]), sequence([[]] * 2), ["car"], {"car": 0}
    )
    two = trajectories(labels([(0, 5, car(9))]), sequence([[]]), ["car"], {"car": 0})
    both = join([one, two])
    assert both.first_row.tolist() == [0, 2]
    assert both.truth[both.first_row, 0].tolist() == [0.0, 9.0]


def test_real_detections_cover_most_real_labels(test_data: Path) -> None:
    table = real_dataset(test_data).labels("0020")
    assert table is not None
    frames = real_frames(test_data, "0020")
    found = trajectories(table, frames, ["car"], {"car": 0})
    assert found.seen.mean() > 0.85
    error = np.linalg.norm(found.measured[found.seen, :2] - found.truth[found.seen, :2], axis=1)
    assert np.median(error) < 0.15
