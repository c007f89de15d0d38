"""Real drives, ingested on the way."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from shutil import copy
from tempfile import mkdtemp

from hbbatch.dataset import Dataset
from hbbatch.model.kinds import KIND_OF_CLASS
from hbbatch.runner.ingest import ingest
from hbbatch.sources.base import SourceOptions
from hbbatch.tracking.frames import SequenceFrames, sequence_frames


@cache
def real_dataset(test_data: Path, detector: str = "virconv") -> Dataset:
    """All KITTI training sequences with the detections of one detector."""
    root = Path(mkdtemp(prefix="hbbatch-test-")) / "dataset"
    kitti = test_data / "kitti"
    found = kitti / "detections" / detector / "training"
    ingest([kitti / "training"], root, options=SourceOptions(found))
    return Dataset.open(root)


@cache
def few_drives(test_data: Path, *sequence_ids: str) -> Dataset:
    """Some KITTI training sequences only, with VirConv detections."""
    folder = Path(mkdtemp(prefix="hbbatch-test-"))
    kitti = test_data / "kitti"
    sources = {name: kitti / "training" / name for name in ("calib", "oxts", "label_02")}
    sources["det_02"] = kitti / "detections" / "virconv" / "training"
    for name, source in sources.items():
        (folder / "kitti" / name).mkdir(parents=True)
        for sequence_id in sequence_ids:
            copy(source / f"{sequence_id}.txt", folder / "kitti" / name)
    ingest([folder / "kitti"], folder / "dataset")
    return Dataset.open(folder / "dataset")


@cache
def real_frames(test_data: Path, sequence_id: str) -> SequenceFrames:
    """VirConv detections of a KITTI training sequence."""
    dataset = real_dataset(test_data)
    detections, poses = dataset.detections(sequence_id), dataset.poses(sequence_id)
    return sequence_frames(sequence_id, detections, poses, list(KIND_OF_CLASS))
