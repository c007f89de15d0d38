"""Datasets of a few boxes, and a tracker that needs no network, for tests of the runner."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from hbbatch import schema
from hbbatch.config import DeviceName, TrackSettings
from hbbatch.dataset import Dataset
from hbbatch.dataset.store import write_json, write_table
from hbbatch.errors import WeightsError
from hbbatch.runner.orders import LoadedTracker
from hbbatch.runner.track import Engine
from hbbatch.tracking.frames import SequenceFrames
from hbbatch.tracking.tracks import SequenceTracks, TrackedSequence

CAMERA = {
    "image_from_sensor": [[600.0, -700, 0, 0], [180.0, 0, -700, 0], [1.0, 0, 0, 0]],
    "image_width_px": 1242,
    "image_height_px": 375,
    "frame_id": "camera",
}


def catalog_row(sequence_id: str, **values: Any) -> dict[str, Any]:
    row = {
        "sequence_id": sequence_id,
        "source": f"/drives/{sequence_id}",
        "source_format": "test",
        "source_hash": "s",
        "content_hash": f"content of {sequence_id}",
        "frames": 3,
        "detections": 6,
        "labels": 0,
        "duration_s": 0.2,
        "pose_origin": "identity",
        "partial": False,
        "problems": [],
    }
    return row | values


def write_catalog(dataset: Dataset, *rows: dict[str, Any]) -> None:
    dataset.write_catalog(pa.Table.from_pylist(list(rows), schema=schema.CATALOG))


def make_dataset(root: Path, *sequence_ids: str, frames: int = 3) -> Dataset:
    """A dataset in which every frame has two cars straight ahead."""
    dataset = Dataset.create(root)
    for sequence_id in sequence_ids:
        write_sequence(dataset, sequence_id, frames)
    write_catalog(dataset, *(catalog_row(s, frames=frames) for s in sequence_ids))
    return dataset


def write_sequence(dataset: Dataset, sequence_id: str, frames: int, cars: int = 2) -> None:
    detections = [_detection(f, f * cars + car) for f in range(frames) for car in range(cars)]
    poses = [_pose(frame) for frame in range(frames)]
    for name, rows, expected in (
        ("detections", detections, schema.DETECTIONS),
        ("poses", poses, schema.POSES),
    ):
        table = pa.Table.from_pylist(rows, schema=expected)
        write_table(dataset.path(name, sequence_id), table, expected)
    write_json(dataset.calibration_path(sequence_id), CAMERA)


def _stamp(frame: int) -> dict[str, int]:
    return {"frame_index": frame, "timestamp_ns": frame * 100_000_000}


def _detection(frame: int, detection_id: int) -> dict[str, Any]:
    return {
        **_stamp(frame),
        "detection_id": detection_id,
        "class_name": "car",
        "class_name_logged": "Car",
        "score": 0.5,
        "x": 10.0 + 10 * (detection_id % 2),
        "y": 0.0,
        "z": 0.0,
        "length": 4.0,
        "width": 2.0,
        "height": 1.5,
        "yaw": 0.0,
        "frame_id": "camera",
        "source_row": detection_id,
    }


def _pose(frame: int) -> dict[str, Any]:
    return {
        **_stamp(frame),
        **{f"translation_{axis}": 0.0 for axis in "xyz"},
        **{f"rotation_{axis}": 0.0 for axis in "xyz"},
        "rotation_w": 1.0,
        "origin": "identity",
        "frame_id": "camera",
    }


class EchoTracker:
    """The n-th detection of every frame is track n; some sequence ids make it misbehave."""

    class_names = ("car",)

    def track(self, group: Sequence[SequenceFrames]) -> Iterator[TrackedSequence]:
        for frames in group:
            if frames.sequence_id == "raises":
                raise ValueError("matrix is\nsingular")
            if frames.sequence_id == "kills":
                os.kill(os.getpid(), signal.SIGKILL)
            if frames.sequence_id == "sleeps":
                time.sleep(60)
        for frames in group:
            if frames.sequence_id != "forgotten":
                yield TrackedSequence(frames, _echo(frames), frames.scores, frames.scores)


def _echo(frames: SequenceFrames) -> SequenceTracks:
    count = len(frames.boxes)
    per_frame = np.diff(frames.offsets)
    frame_index = np.repeat(np.arange(frames.frame_count), per_frame)
    return SequenceTracks(
        frame_index=frame_index,
        track_id=np.arange(count) - frames.offsets[frame_index] + 1,
        class_code=np.zeros(count, np.int64),
        state=np.zeros(count, np.int8),
        score=frames.scores,
        boxes=frames.boxes,
        velocity_m_s=np.zeros((count, 3)),
        detection_row=np.arange(count),
    )


def echo_hash(settings: TrackSettings) -> str:
    return "weights"


def load_echo(settings: TrackSettings, device: DeviceName) -> LoadedTracker:
    return LoadedTracker(EchoTracker(), "cpu")


def load_says_cores(settings: TrackSettings, device: DeviceName) -> LoadedTracker:
    """The device is a list of the cores that this process may use."""
    return LoadedTracker(EchoTracker(), json.dumps(sorted(os.sched_getaffinity(0))))


def load_fails(settings: TrackSettings, device: DeviceName) -> LoadedTracker:
    raise WeightsError("weights.safetensors: of another version. Train again.")


def load_breaks(settings: TrackSettings, device: DeviceName) -> LoadedTracker:
    raise ImportError("no module named magic")


ECHO = Engine(echo_hash, lambda settings: settings, load_echo)
