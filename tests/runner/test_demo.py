"""The demo takes the way of a user's log, and its tracks are close to the truth."""

from __future__ import annotations

from pathlib import Path

import pytest

from hbbatch.dataset import Dataset
from hbbatch.errors import UsageError
from hbbatch.runner.demo import SETTINGS, DemoReport, demo

KALMAN = SETTINGS.model_copy(update={"filter": "kalman"})


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> DemoReport:
    return demo(tmp_path_factory.mktemp("demo"), seed=1, settings=KALMAN, duration_s=8.0)


def test_all_tables_of_a_drive_are_there(report: DemoReport) -> None:
    dataset = Dataset.open(report.dataset)
    row = dataset.catalog().to_pylist()[0]
    labels = dataset.labels(report.sequence_id)
    assert report.log.is_file()
    assert (row["frames"], row["source_format"], row["pose_origin"]) == (80, "mcap", "logged")
    assert row["problems"] == []
    assert labels is not None
    assert row["labels"] == labels.num_rows > 300
    assert labels["timestamp_ns"][0] == dataset.poses(report.sequence_id)["timestamp_ns"][0]


def test_tracks_are_close_to_the_truth(report: DemoReport) -> None:
    cars = report.evaluation.evaluation.classes["car"].combined
    assert report.evaluation.evaluation.protocol == "box_3d"
    assert cars.labelled_boxes > 200
    assert cars.hota > 60
    assert cars.mota > 65


def test_again_gives_the_same_and_another_seed_another_drive(
    report: DemoReport, tmp_path: Path
) -> None:
    first = demo(tmp_path, seed=1, settings=KALMAN, duration_s=8.0)
    assert first.log.read_bytes() == report.log.read_bytes()
    assert first.evaluation.evaluation == report.evaluation.evaluation
    other = demo(tmp_path, seed=2, settings=KALMAN, duration_s=8.0)
    assert other.evaluation.evaluation != first.evaluation.evaluation
    assert Dataset.open(other.dataset).sequence_ids() == ["drive"]


def test_a_file_in_place_of_the_folder_is_named_with_the_option(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"file: is a file\. Name another folder with --out\."):
        demo(tmp_path / "file")
