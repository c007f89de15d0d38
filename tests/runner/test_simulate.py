"""Datasets of simulated drives are like any other, and can be trained on."""

from __future__ import annotations

from pathlib import Path

import pytest

from hbbatch.dataset import Dataset
from hbbatch.errors import UsageError
from hbbatch.model.train_settings import TrainSettings
from hbbatch.runner.simulate import SimulatedDrive, simulate
from hbbatch.runner.train import train

QUICK = TrainSettings(iterations=2, batch=8, frames=6, noise_iterations=2)
DURATION_S = 8.0


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> tuple[Dataset, list[SimulatedDrive]]:
    root = tmp_path_factory.mktemp("simulated")
    drives = simulate(root, drives=3, seed=4, duration_s=DURATION_S)
    return Dataset.open(root), drives


def test_every_drive_has_its_tables_and_its_row(
    dataset: tuple[Dataset, list[SimulatedDrive]],
) -> None:
    there, drives = dataset
    assert there.sequence_ids() == [drive.sequence_id for drive in drives]
    for drive, row in zip(drives, there.catalog().to_pylist(), strict=True):
        labels = there.labels(drive.sequence_id)
        assert labels is not None
        assert row["labels"] == labels.num_rows == drive.labels > 50
        assert row["detections"] == there.detections(drive.sequence_id).num_rows > 50
        assert row["frames"] == DURATION_S * drive.settings.rate_hz
        assert row["source_format"] == "simulated"
        assert row["problems"] == []


def test_drives_differ_and_come_again_with_the_same_seed(
    dataset: tuple[Dataset, list[SimulatedDrive]], tmp_path: Path
) -> None:
    there, drives = dataset
    assert len({drive.settings.detector.position_noise_m for drive in drives}) == 3
    again = simulate(tmp_path, drives=1, seed=4, duration_s=DURATION_S)
    assert again[0] == drives[0]
    hashes = Dataset.open(tmp_path).catalog()["content_hash"].to_pylist()
    assert hashes == there.catalog()["content_hash"].to_pylist()[:1]


def test_filters_are_trained_on_them(
    dataset: tuple[Dataset, list[SimulatedDrive]], tmp_path: Path
) -> None:
    report = train([dataset[0].root], tmp_path / "s.safetensors", QUICK)
    assert set(report.errors) == set(report.calibration) >= {"vehicle", "pedestrian"}


def test_a_file_in_place_of_the_dataset_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"file: is a file\. Name another folder"):
        simulate(tmp_path / "file", drives=1)
