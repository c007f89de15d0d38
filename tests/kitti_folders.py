"""Tiny KITTI tracking folders written by tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

CALIBRATION = {
    "P2": "721.5377 0 609.5593 44.85728 0 721.5377 172.854 0.2163791 0 0 1 0.002745884",
    "R0_rect": "1 0 0 0 1 0 0 0 1",
    "Tr_velo_to_cam": "0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27",
    "Tr_imu_to_velo": "1 0 0 -0.81 0 1 0 0.32 0 0 1 -0.8",
}
CAR = "Car -1 -1 0.1 100 150 200 250 1.5 1.6 4.0 2.0 1.7 20.0 0.3"
"""A KITTI object without frame in front and score behind."""


def calibration_text(**changes: str) -> str:
    """A calib file; keyword arguments replace lines, an empty one removes its line."""
    lines = {**CALIBRATION, **changes}
    return "".join(f"{key}: {value}\n" for key, value in lines.items() if value)


def oxts_text(frames: int, metres_per_frame: float = 1.0, yaw: float = 0.0) -> str:
    """A car near the equator that drives straight along its heading."""
    metres = np.arange(frames) * metres_per_frame
    longitude = np.degrees(metres * np.cos(yaw) / 6378137.0)
    latitude = np.degrees(metres * np.sin(yaw) / 6378137.0)
    rest = " ".join(["0"] * 24)
    return "".join(
        f"{lat!r} {lon!r} 100.0 0.0 0.0 {yaw!r} {rest}\n"
        for lat, lon in zip(latitude.tolist(), longitude.tolist(), strict=True)
    )


def write_sequence(
    root: Path,
    sequence_id: str = "0000",
    *,
    frames: int = 3,
    detections: Sequence[str] | None = None,
    calibration: str | None = None,
    oxts: str | None = None,
    labels: str | None = None,
) -> Path:
    """A sequence with a car in each frame; texts replace the content of files."""
    if detections is None:
        detections = [f"{frame} {CAR} 0.9" for frame in range(frames)]
    contents = {
        "calib": calibration_text() if calibration is None else calibration,
        "oxts": oxts_text(frames) if oxts is None else oxts,
        "label_02": labels,
        "det_02": "".join(f"{line}\n" for line in detections),
    }
    for folder, text in contents.items():
        if text is not None:
            path = root / folder / f"{sequence_id}.txt"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
    return root
