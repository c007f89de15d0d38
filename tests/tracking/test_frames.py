"""Detections as the tracker is given them."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from hbbatch.boxes import BOX_FIELDS
from hbbatch.errors import SequenceError
from hbbatch.tracking.frames import sequence_frames

BOX = [10.0, 1.0, 0.5, 4.0, 1.8, 1.5, 0.1]


def tables(boxes: list[list[float]]) -> tuple[pa.Table, pa.Table]:
    """Cars in frame 0, seen from the world's origin."""
    count = len(boxes)
    columns = dict(zip(BOX_FIELDS, np.array(boxes).T, strict=True))
    detections = pa.table(
        {
            "frame_index": np.zeros(count, np.int32),
            "detection_id": np.arange(count),
            "class_name": ["car"] * count,
            "score": np.ones(count),
            **columns,
        }
    )
    still = {f"translation_{a}": [0.0] for a in "xyz"} | {f"rotation_{a}": [0.0] for a in "xyz"}
    return detections, pa.table({"timestamp_ns": [0], **still, "rotation_w": [1.0]})


def test_boxes_are_moved_to_the_world() -> None:
    assert sequence_frames("s", *tables([BOX]), ["car"]).boxes == pytest.approx(np.array([BOX]))


@pytest.mark.parametrize("field", BOX_FIELDS)
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e38])
def test_a_box_that_is_none_fails_its_sequence(field: str, wrong: float) -> None:
    bad = [wrong if name == field else value for name, value in zip(BOX_FIELDS, BOX, strict=True)]
    with pytest.raises(SequenceError, match=f"sequence s: 1 detected boxes are none.*{field} "):
        sequence_frames("s", *tables([BOX, bad]), ["car"])


@pytest.mark.parametrize("size", [0.0, -1.0])
def test_a_box_without_size_fails_its_sequence(size: float) -> None:
    with pytest.raises(SequenceError, match=f"width {size:g}"):
        sequence_frames("s", *tables([[*BOX[:4], size, *BOX[5:]]]), ["car"])
