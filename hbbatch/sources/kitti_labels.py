"""Labels of a KITTI sequence (label_02)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hbbatch.boxes import are_boxes
from hbbatch.sources.base import Labels
from hbbatch.sources.classes import DONT_CARE, normalise_class
from hbbatch.sources.kitti_detections import NOT_A_BOX, check_frames, image_boxes
from hbbatch.sources.kitti_geometry import SENSOR_FRAME, sensor_boxes
from hbbatch.sources.kitti_text import LABEL_LAYOUT, parse_rows

FRAME_NS = 100_000_000
"""Time between frames: the tracking benchmark gives no stamps, the car recorded at 10 Hz."""


def read_labels(path: Path) -> Labels:
    """All labels of a sequence; DontCare regions have object id -1 and no 3D box.

    Raises:
        SourceError: a line is malformed, a box has a size of zero or less, or a frame number is
            absurd.
    """
    rows = parse_rows(path, LABEL_LAYOUT)
    frame_index = rows.whole("frame", 0)
    check_frames([(frame_index, rows)])
    ignored = np.array([normalise_class(name) == DONT_CARE for name in rows.types], dtype=bool)
    boxes = sensor_boxes(rows.stack("height width length x y z ry"))
    rows.refuse(~are_boxes(boxes) & ~ignored, NOT_A_BOX)
    boxes[ignored] = np.nan
    order = np.argsort(frame_index, kind="stable")
    return Labels(
        frame_index=frame_index[order],
        timestamp_ns=frame_index[order] * FRAME_NS,
        object_id=np.where(ignored, -1, rows.whole("id", -1))[order],
        class_names=[rows.types[row] for row in order],
        boxes=boxes[order],
        frame_id=SENSOR_FRAME,
        image_boxes=image_boxes(rows)[order],
        truncation=rows.values["truncation"][order],
        occlusion=rows.whole("occlusion", -1)[order],
    )
