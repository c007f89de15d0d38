"""A few sequences of the real KITTI folder, copied."""

from __future__ import annotations

import shutil
from pathlib import Path


def copy_sequences(test_data: Path, target: Path, *sequence_ids: str) -> Path:
    """Calibration, poses, VirConv's detections and labels, where there are any."""
    kitti = test_data / "kitti"
    folders = {name: kitti / "training" / name for name in ("calib", "oxts", "label_02")}
    folders["det_02"] = kitti / "detections/virconv/training"
    for name, source in folders.items():
        (target / name).mkdir(parents=True)
        for sequence_id in sequence_ids:
            if (source / f"{sequence_id}.txt").exists():
                shutil.copy(source / f"{sequence_id}.txt", target / name)
    return target
