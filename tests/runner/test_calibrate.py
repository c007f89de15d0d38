"""Settings for a detector, found on real drives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from hbbatch.config import TrackSettings, validate
from hbbatch.errors import DatasetError, UsageError
from hbbatch.runner.calibrate import calibrate
from hbbatch.runner.evaluate import evaluate
from hbbatch.runner.track import TrackRequest, track
from hbbatch.runner.track_settings import resolve_settings
from tests.runner.small_dataset import make_dataset
from tests.tracking.real_drives import few_drives, real_dataset

CLASSICAL = TrackSettings(filter="kalman")
DRIVES = ("0000", "0003", "0005")


def test_the_file_is_a_settings_file_that_improves_the_tracks(
    test_data: Path, tmp_path: Path
) -> None:
    root = few_drives(test_data, *DRIVES).root
    report = calibrate([root], tmp_path / "cuts.yaml", CLASSICAL)
    assert report.weights == {}
    assert report.sequences == len(DRIVES)
    scale = report.scales["car"]
    assert 1.0 < scale.typical < scale.strong < 9.0
    assert not scale.probability

    hota = {}
    for name, config in {"uncut": None, "cut": report.out}.items():
        settings = resolve_settings(config, {"filter": "kalman"})
        track(TrackRequest(root, settings, run=name, workers=1))
        hota[name] = evaluate(root, name, classes=["car"]).evaluation.classes["car"].combined.hota
    assert hota["cut"] > hota["uncut"] + 2.0


def test_sequences_can_be_named(test_data: Path, tmp_path: Path) -> None:
    root, out = few_drives(test_data, *DRIVES).root, tmp_path / "cuts.yaml"
    assert calibrate([root], out, CLASSICAL, ["0000", "0005"]).sequences == 2
    with pytest.raises(UsageError, match="no such sequence in the dataset: '0001'"):
        calibrate([root], out, CLASSICAL, ["0001"])


def test_a_sequence_in_the_place_of_the_file_is_not_written_over(tmp_path: Path) -> None:
    root = make_dataset(tmp_path / "data", "0001", "0002").root
    with pytest.raises(UsageError, match=r"0001: settings are written as \.yaml"):
        calibrate([root], Path("0001"), CLASSICAL, ["0002"])


def test_sequences_named_to_learn_from_must_be_labelled(tmp_path: Path) -> None:
    root = make_dataset(tmp_path / "data", "a").root
    with pytest.raises(DatasetError, match="labels for none of the sequences named"):
        calibrate([root], tmp_path / "mine.yaml", CLASSICAL, ["a"], from_labels=True)


def test_labels_teach_weights_for_both_protocols(test_data: Path, tmp_path: Path) -> None:
    root = real_dataset(test_data).root
    report = calibrate([root], tmp_path / "mine.yaml", CLASSICAL, from_labels=True)
    assert set(report.weights) == {"gap_filled", "online"}
    for of_protocol in report.weights.values():
        assert list(of_protocol) == ["vehicle"]
        assert of_protocol["vehicle"].detected.detection_score > 0.3
        assert of_protocol["vehicle"].undetected.nearby_score > 0.3
        assert of_protocol["vehicle"].undetected.presence > 0.3
    written = validate(TrackSettings, yaml.safe_load(report.out.read_text()), "mine.yaml").output
    assert written.confidence == report.weights
    typical = report.scales["car"].typical
    assert written.score_scale["car"].typical == pytest.approx(typical, abs=1e-4)


def test_several_detectors_share_weights_but_no_scale(test_data: Path, tmp_path: Path) -> None:
    roots = [real_dataset(test_data, name).root for name in ("virconv", "pointrcnn")]
    with pytest.raises(UsageError, match="one dataset at a time"):
        calibrate(roots, tmp_path / "a.yaml", CLASSICAL)
    report = calibrate(roots, tmp_path / "b.yaml", CLASSICAL, from_labels=True)
    assert report.scales == {}
    weights = report.weights["online"]
    assert set(weights) == {"vehicle", "pedestrian", "cyclist"}
    for weights_of_kind in weights.values():
        assert np.isfinite(weights_of_kind.detected.in_order()).all()
        assert np.isfinite(weights_of_kind.undetected.in_order()).all()


def test_too_little_to_tell_is_an_error_and_nothing_is_written(tmp_path: Path) -> None:
    root = make_dataset(tmp_path / "data", "a").root
    out = tmp_path / "cuts.yaml"
    with pytest.raises(DatasetError, match="too few detections on tracks that persist"):
        calibrate([root], out, CLASSICAL)
    with pytest.raises(DatasetError, match="holds no labelled sequence"):
        calibrate([root], out, CLASSICAL, from_labels=True)
    assert not out.exists()
