"""Training from datasets to weights files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hbbatch.errors import DatasetError, UsageError
from hbbatch.model.train_settings import TrainSettings
from hbbatch.model.weights import load_filter
from hbbatch.runner.train import train
from tests.runner.small_dataset import make_dataset
from tests.tracking.real_drives import few_drives

QUICK = TrainSettings(iterations=2, batch=8, frames=6, noise_iterations=2)


def test_weights_say_what_they_were_trained_on(test_data: Path, tmp_path: Path) -> None:
    root = few_drives(test_data, "0000", "0003").root
    out = tmp_path / "mine.safetensors"
    report = train([root], out, QUICK, hold_out=["0003"], licence="mine")
    about = load_filter("hybrid", str(out), None).header.about
    assert about["licence"] == "mine"
    assert about["settings"]["frames"] == 6
    assert len(about["data_hash"]) == 64
    assert report.held_out == [f"{root.name}:0003"]
    assert report.sequences == [f"{root.name}:0000"]
    assert set(report.errors) == {"vehicle"}, "VirConv detects cars only"
    beside = json.loads(out.with_suffix(".json").read_text())
    assert beside["tracklets"] == report.tracklets


def test_the_paper_can_be_taken_literally(test_data: Path, tmp_path: Path) -> None:
    """Fed with labels, there are no misses and no measurement noise."""
    literal = QUICK.model_copy(
        update={"measurements": "labels", "temporal_weight": 1.0, "max_tracklets": 16}
    )
    report = train(
        [few_drives(test_data, "0000", "0003").root], tmp_path / "a.safetensors", literal
    )
    assert report.tracklets == 16


def test_the_classical_filter_is_fitted_by_the_same_command(
    test_data: Path, tmp_path: Path
) -> None:
    out = tmp_path / "k.safetensors"
    train([few_drives(test_data, "0000", "0003").root], out, QUICK, kind="kalman")
    assert load_filter("kalman", str(out), ["car"]).class_names == ("car",)


def test_what_cannot_be_trained_is_said_in_one_line(test_data: Path, tmp_path: Path) -> None:
    root = few_drives(test_data, "0000", "0003").root
    with pytest.raises(UsageError, match="0001"):
        train([root], tmp_path / "a.safetensors", QUICK, hold_out=["0001"])
    with pytest.raises(UsageError, match=r"written as \.safetensors"):
        train([root], tmp_path / "a.pt", QUICK)
    with pytest.raises(DatasetError, match="no dataset here"):
        train([tmp_path / "nothing"], tmp_path / "a.safetensors", QUICK)
    assert not list(tmp_path.glob("*.safetensors"))


def test_a_dataset_without_labels_cannot_be_trained_on(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path / "data")
    with pytest.raises(DatasetError, match="no labelled objects"):
        train([dataset.root], tmp_path / "a.safetensors", QUICK)
