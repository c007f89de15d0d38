"""Tiny sequences for tests of the tracker."""

from __future__ import annotations

import numpy as np

from hbbatch.tracking.frames import SequenceFrames


def sequence(
    frames: list[list[list[float]]],
    scores: list[list[float]] | None = None,
    codes: list[list[int]] | None = None,
    name: str = "s",
    dt_s: float = 0.1,
) -> SequenceFrames:
    """Boxes frame by frame, in a sensor that stands at the world's origin."""
    counts = [len(boxes) for boxes in frames]
    boxes = np.array([box for frame in frames for box in frame], float).reshape(-1, 7)
    count = len(frames)
    return SequenceFrames(
        sequence_id=name,
        timestamp_ns=(np.arange(count) * dt_s * 1e9).astype(np.int64),
        offsets=np.cumsum([0, *counts]),
        boxes=boxes,
        sight_m=boxes[:, :3].copy(),
        scores=np.concatenate([*(scores or []), []]) if scores else np.ones(len(boxes)),
        class_codes=np.concatenate([*(codes or []), []]).astype(np.int64)
        if codes
        else np.zeros(len(boxes), np.int64),
        detection_ids=np.arange(len(boxes)) + 100,
        rotation=np.tile(np.eye(3), (count, 1, 1)),
        translation_m=np.zeros((count, 3)),
    )


def car(x: float, y: float = 0.0, yaw: float = 0.0) -> list[float]:
    return [x, y, 0.8, 4.5, 1.8, 1.5, yaw]


def passing_cars(
    seed: int, frames: int = 60, cars: int = 6, name: str = "s", doubled: float = 0.0
) -> SequenceFrames:
    """Cars on parallel lanes with noise, misses and false detections; some are detected twice."""
    rng = np.random.default_rng(seed)
    start, speed = rng.uniform(-30, 30, cars), rng.uniform(-12, 12, cars)
    drive = []
    for frame in range(frames):
        seen = [
            car(start[i] + 0.1 * frame * speed[i] + rng.normal(0, 0.1), 4.0 * i)
            for i in range(cars)
            if rng.random() < 0.8
        ]
        seen += [car(*rng.uniform(-40, 40, 2)) for _ in range(rng.poisson(0.5))]
        drive.append(seen + [box for box in seen if rng.random() < doubled])
    return sequence(drive, name=name)
