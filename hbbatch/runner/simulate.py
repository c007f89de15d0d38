"""Labelled datasets of simulated drives, written through the same tables as ingested ones."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from hbbatch.dataset import Dataset
from hbbatch.errors import UsageError
from hbbatch.runner.ingest_catalog import put_rows
from hbbatch.runner.ingest_tables import write_sequence
from hbbatch.sources.base import (
    LOGGED,
    Findings,
    FrameBatch,
    Names,
    Poses,
    SequenceReading,
    no_image_boxes,
)
from hbbatch.sources.classes import load_taxonomy
from hbbatch.synthetic.drive import Drive, simulate_drive
from hbbatch.synthetic.labels import labels_table
from hbbatch.synthetic.settings import CLASS_NAMES, DriveSettings
from hbbatch.synthetic.variety import varied_settings

SOURCE_FORMAT: Final = "simulated"
SENSOR_FRAME: Final = "lidar"
LONGEST_HIDDEN_S: Final = 0.5
"""How long before and after it is seen a hidden object is labelled: people label what they see."""


@dataclass(frozen=True)
class SimulatedDrive:
    """One drive that was written.

    Attributes:
        sequence_id: what it is called.
        settings: what it was made from.
        detections: boxes that the detector said.
        labels: boxes that there were.
    """

    sequence_id: str
    settings: DriveSettings
    detections: int
    labels: int


def simulate(
    root: Path,
    drives: int,
    seed: int = 0,
    duration_s: float = 30.0,
    on_drive: Callable[[SimulatedDrive], None] = lambda _: None,
) -> list[SimulatedDrive]:
    """Simulate drives that differ in everything and add them to a dataset, made if there is none.

    The same seed gives the same drives; a drive of the same seed and number replaces the former.

    Args:
        root: the dataset folder.
        drives: how many.
        seed: another seed is other drives.
        duration_s: length of each.
        on_drive: called when a drive is written.

    Raises:
        UsageError: `root` is a file.
        DatasetError: the dataset cannot be written, or was written by a newer version.
    """
    if root.exists() and not root.is_dir():
        raise UsageError(f"{root}: is a file. Name another folder for the dataset.")
    dataset = Dataset.create(root)
    done = []
    for number, rng in enumerate(np.random.default_rng(seed).spawn(drives)):
        settings = varied_settings(rng, duration_s)
        drive = simulate_drive(settings, int(rng.integers(2**31)))
        done.append(_write(dataset, f"simulated-{seed}-{number:04d}", drive))
        on_drive(done[-1])
    return done


def _write(dataset: Dataset, sequence_id: str, drive: Drive) -> SimulatedDrive:
    source = dataset.root / SOURCE_FORMAT
    reading = SequenceReading(sequence_id, _batches(drive), None, None, Findings())
    source_hash = _hash(asdict(drive.settings), sequence_id)
    labels = labels_table(drive, SENSOR_FRAME, LONGEST_HIDDEN_S)
    row = write_sequence(dataset, source, source_hash, reading, load_taxonomy(None), labels)
    row |= {
        "source": str(source.resolve()),
        "source_format": SOURCE_FORMAT,
    }
    put_rows(dataset, source, [row], [])
    return SimulatedDrive(sequence_id, drive.settings, row["detections"], labels.num_rows)


def _hash(settings: dict[str, Any], sequence_id: str) -> str:
    return hashlib.sha256(repr((settings, sequence_id)).encode()).hexdigest()


def _batches(drive: Drive) -> Iterator[FrameBatch]:
    """The whole drive as one batch."""
    frames = drive.frames
    said = [frame.detections for frame in frames]
    count = sum(len(d.scores) for d in said)
    codes = np.concatenate([d.class_codes for d in said])
    rotation = Rotation.from_matrix(np.array([f.logged_pose.rotation for f in frames]))
    yield FrameBatch(
        timestamp_ns=np.array([frame.timestamp_ns for frame in frames]),
        log_time_ns=None,
        frame_ids=Names(np.zeros(len(frames), np.int64), (SENSOR_FRAME,)),
        poses=Poses(
            np.array([frame.logged_pose.translation_m for frame in frames]),
            rotation.as_quat(),
            Names.of([LOGGED] * len(frames)),
        ),
        box_counts=np.array([len(d.scores) for d in said]),
        boxes=np.concatenate([d.boxes for d in said]),
        scores=np.concatenate([d.scores for d in said]),
        class_names=Names(codes, CLASS_NAMES),
        image_boxes=no_image_boxes(count),
        source_rows=np.arange(count),
    )
