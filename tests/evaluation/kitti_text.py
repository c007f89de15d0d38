"""KITTI label files as labels tables, and made-up tracking results for them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa

from hbbatch import schema

FALSE_BOX_ID = 100_000


def labels_table(path: Path) -> pa.Table:
    rows = [line.split() for line in path.read_text().splitlines()]
    values = np.array([[*row[:2], *row[3:]] for row in rows], float)
    names = pa.array([row[2] for row in rows])
    nothing = pa.nulls(len(rows), pa.float64())
    columns = {
        "frame_index": pa.array(values[:, 0].astype(np.int32)),
        "timestamp_ns": pa.array(values[:, 0].astype(np.int64)),
        "object_id": pa.array(values[:, 1].astype(np.int64)),
        "class_name": names,
        "class_name_logged": names,
        **dict.fromkeys(("x", "y", "z", "length", "width", "height", "yaw"), nothing),
        "frame_id": pa.array(["camera"] * len(rows)),
        **{
            f"image_{side}": pa.array(values[:, 5 + i])
            for i, side in enumerate(("left", "top", "right", "bottom"))
        },
        "truncation": pa.array(values[:, 2]),
        "occlusion": pa.array(values[:, 3].astype(np.int32)),
    }
    return schema.conform(pa.table(columns), schema.LABELS, str(path))


def fake_results(label_file: Path, rng: np.random.Generator) -> str:
    """A tracking result with every kind of fault: jitter, misses, switched and false boxes."""
    lines = []
    for number, line in enumerate(label_file.read_text().splitlines()):
        frame, object_id, kind, *rest = line.split()
        box = np.array(rest[3:7], float)
        if rng.random() < 0.15:
            continue
        if kind == "DontCare":
            object_id, kind = str(FALSE_BOX_ID + number), "Car"
        switched = int(frame) > 40 and int(object_id) % 3 == 0
        identity = int(object_id) + (1000 if switched else 0)
        jittered = box + rng.normal(0, 0.08, 4) * np.tile(box[2:] - box[:2], 2)
        lines.append(_line(frame, identity, _said(kind, rng), jittered, rng.random()))
        if rng.random() < 0.1:
            box = np.array([0.0, 0.0, 60.0, 40.0]) + np.tile(rng.uniform(0, 300, 2), 2)
            false_id = FALSE_BOX_ID * 2 + number
            lines.append(_line(frame, false_id, rng.choice(["Car", "Pedestrian"]), box, 0.0))
    return "".join(lines)


def _said(kind: str, rng: np.random.Generator) -> str:
    wrong = rng.choice(["Car", "Pedestrian", "Cyclist"])
    return "Car" if kind in ("Van", "Truck") else wrong if rng.random() < 0.05 else kind


def _line(frame: str, identity: int, kind: str, box: np.ndarray, score: float) -> str:
    image = " ".join(f"{edge:.4f}" for edge in box)
    return f"{frame} {identity} {kind} -1 -1 -10 {image} 1 1 1 0 0 0 0 {score:.4f}\n"
