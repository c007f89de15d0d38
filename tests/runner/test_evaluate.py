"""A run of a dataset is scored against its labels, in the protocol that its labels allow."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from typer.testing import CliRunner

from hbbatch import schema
from hbbatch.boxes import BOX_FIELDS
from hbbatch.cli.main import app
from hbbatch.dataset import Dataset
from hbbatch.dataset.store import write_json, write_table
from hbbatch.errors import DatasetError, SequenceError, UsageError
from hbbatch.runner.evaluate import evaluate

FRAMES = 10
CALIBRATION = {
    "image_from_sensor": [[500.0, -700.0, 0, 0], [200.0, 0, -700.0, 0], [1.0, 0, 0, 0]],
    "image_width_px": 1000,
    "image_height_px": 400,
    "frame_id": "camera",
}


def car_boxes() -> np.ndarray:
    """A car driving ahead, drifting to the left, a box a frame, in the sensor frame."""
    boxes = np.tile([15.0, 0.0, 0.0, 4.0, 1.8, 1.5, 0.0], (FRAMES, 1))
    boxes[:, 0] += np.arange(FRAMES)
    boxes[:, 1] += 0.2 * np.arange(FRAMES)
    return boxes


def write_labels(dataset: Dataset, sequence_id: str, boxes: np.ndarray, in_image: bool) -> None:
    count = len(boxes)
    edges = np.array([450.0, 150.0, 550.0, 250.0])
    sides = ("left", "top", "right", "bottom")
    columns = {
        "frame_index": np.arange(count, dtype=np.int32),
        "timestamp_ns": np.arange(count),
        "object_id": np.full(count, 7),
        "class_name": ["car"] * count,
        "class_name_logged": ["Car"] * count,
        **{name: boxes[:, i] for i, name in enumerate(BOX_FIELDS)},
        "frame_id": ["camera"] * count,
        "truncation": np.zeros(count),
        "occlusion": np.zeros(count, np.int32),
    }
    if in_image:
        columns |= {f"image_{s}": np.full(count, e) for s, e in zip(sides, edges, strict=True)}
        write_json(dataset.calibration_path(sequence_id), CALIBRATION)
    write_table(dataset.path("labels", sequence_id), pa.table(columns), schema.LABELS)


def write_tracks(dataset: Dataset, run: str, sequence_id: str, boxes: np.ndarray) -> None:
    count = len(boxes)
    columns = {
        "frame_index": np.arange(count, dtype=np.int32),
        "timestamp_ns": np.arange(count),
        "track_id": np.full(count, 1),
        "class_name": ["car"] * count,
        "state": ["detected"] * count,
        "score": np.ones(count),
        "track_score": np.ones(count),
        **{name: boxes[:, i] for i, name in enumerate(BOX_FIELDS)},
        **{f"sensor_{name}": boxes[:, i] for i, name in enumerate(BOX_FIELDS)},
        **{f"velocity_{axis}": np.zeros(count) for axis in "xyz"},
    }
    handle = dataset.run(run)
    write_table(handle.tracks(sequence_id), pa.table(columns), schema.TRACKS)
    write_json(handle.manifest, {})


def make_dataset(root: Path, *sequence_ids: str) -> Dataset:
    dataset = Dataset.create(root)
    count = len(sequence_ids)
    numbers = {name: np.zeros(count, int) for name in ("frames", "detections", "labels")}
    words = ("source", "source_format", "source_hash", "content_hash", "pose_origin")
    columns = {
        "sequence_id": list(sequence_ids),
        **{name: [""] * count for name in words},
        **numbers,
        "duration_s": np.ones(count),
        "partial": [False] * count,
        "problems": pa.array([[]] * count, pa.list_(pa.string())),
    }
    dataset.write_catalog(pa.table(columns))
    return dataset


@pytest.fixture
def in_space(tmp_path: Path) -> Dataset:
    """Two labelled sequences without a camera, one unlabelled; run "good" tracked all."""
    dataset = make_dataset(tmp_path, "a", "b", "c")
    for sequence_id in ("a", "b", "c"):
        write_tracks(dataset, "good", sequence_id, car_boxes())
    for sequence_id in ("a", "b"):
        write_labels(dataset, sequence_id, car_boxes(), in_image=False)
    return dataset


def test_perfect_tracks_score_100_and_unlabelled_sequences_are_named(in_space: Dataset) -> None:
    report = evaluate(in_space.root)

    scores = report.evaluation.classes["car"].combined
    assert report.evaluation.protocol == "box_3d"
    assert report.run == "good"
    assert report.unlabelled == ["c"]
    assert scores.hota == scores.mota == scores.idf1 == pytest.approx(100.0)
    assert (scores.fp, scores.fn, scores.labelled_boxes) == (0, 0, 2 * FRAMES)
    assert set(report.evaluation.classes["car"].sequences) == {"a", "b"}


def test_boxes_in_space_must_overlap_by_volume(in_space: Dataset) -> None:
    """A box moved by a third of its length shares half of the union's volume."""
    moved = car_boxes()
    moved[:, 0] += 1.3
    write_tracks(in_space, "near", "a", moved)
    moved[:, 0] += 0.1
    write_tracks(in_space, "far", "a", moved)

    near = evaluate(in_space.root, "near", ["a"]).evaluation.classes["car"].combined
    far = evaluate(in_space.root, "far", ["a"]).evaluation.classes["car"].combined
    assert (near.fp, near.fn) == (0, 0)
    assert (far.fp, far.fn) == (FRAMES, FRAMES)
    # LocA is a mean over 19 thresholds; at the nine above the overlap nothing matches, which is 1.
    assert near.loca == pytest.approx(100 * (10 * 2.7 / 5.3 + 9) / 19)


def test_labels_in_the_image_are_scored_in_kittis_protocol(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a")
    write_labels(dataset, "a", car_boxes(), in_image=True)
    write_tracks(dataset, "table", "a", car_boxes())
    write_tracks(dataset, "files", "a", car_boxes())
    lines = [f"{t} 1 Car -1 -1 0 450 150 550 250{' 0' * 7} 1\n" for t in range(FRAMES)]
    dataset.run("files").kitti("a").parent.mkdir()
    dataset.run("files").kitti("a").write_text("".join(lines))

    from_table = evaluate(dataset.root, "table").evaluation
    from_files = evaluate(dataset.root, "files").evaluation
    assert from_table.protocol == from_files.protocol == "kitti_2d"
    assert from_files.classes["car"].combined.hota == pytest.approx(100.0)
    assert 0 < from_table.classes["car"].combined.loca < 100


def test_one_unreadable_sequence_does_not_stop_the_others(in_space: Dataset) -> None:
    in_space.run("good").tracks("b").write_text("no parquet")
    report = evaluate(in_space.root)
    assert list(report.evaluation.classes["car"].sequences) == ["a"]
    assert "tracks of sequence b" in report.failed["b"]

    result = CliRunner().invoke(app, ["eval", "-d", str(in_space.root), "--json"])
    assert result.exit_code == 1
    assert json.loads(result.stdout)["failed"].keys() == {"b"}


def test_table_has_a_row_a_class_and_if_asked_a_sequence(in_space: Dataset) -> None:
    runner = CliRunner(env={"COLUMNS": "200"})
    arguments = ["eval", "-d", str(in_space.root)]
    assert runner.invoke(app, arguments).stdout.count("100.00") == 6
    result = runner.invoke(app, [*arguments, "--per-sequence"])
    assert result.stdout.count("100.00") == 18
    assert "COMBINED" in result.stdout


def test_what_does_not_exist_is_refused_by_name(in_space: Dataset) -> None:
    with pytest.raises(UsageError, match=r"run 'best' does not exist. There are: good"):
        evaluate(in_space.root, "best")
    with pytest.raises(UsageError, match=r"sequence x is not in .*It holds: a, b, c"):
        evaluate(in_space.root, sequences=["x"])
    with pytest.raises(UsageError, match=r"class tram cannot be evaluated here. Labelled: car"):
        evaluate(in_space.root, classes=["tram"])
    with pytest.raises(DatasetError, match="none of the 1 sequences has labels"):
        evaluate(in_space.root, sequences=["c"])
    with pytest.raises(DatasetError, match="nothing was tracked yet"):
        evaluate(make_dataset(in_space.root / "other", "a").root)
    write_tracks(in_space, "partial", "c", car_boxes())
    with pytest.raises(SequenceError, match="sequence a: not tracked in run partial"):
        evaluate(in_space.root, "partial")


def test_sequences_that_the_weights_may_have_learned_from_are_named(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "0000", "mine")
    for sequence_id in ("0000", "mine"):
        write_labels(dataset, sequence_id, car_boxes(), in_image=False)
        write_tracks(dataset, "r", sequence_id, car_boxes())
    weights = {"name": "kitti", "hash": "h"}
    write_json(dataset.run("r").manifest, {"format_version": 1, "weights": weights})
    assert evaluate(tmp_path).perhaps_trained_on == ["0000"]


def test_what_failed_or_was_replaced_since_is_not_scored(in_space: Dataset) -> None:
    write_tracks(in_space, "mixed", "a", car_boxes())
    write_tracks(in_space, "mixed", "b", car_boxes())
    run = in_space.run("mixed")
    write_json(run.status("b"), {"state": "failed", "error": "no room"})
    report = evaluate(in_space.root, "mixed")
    assert "not tracked" in report.failed["b"]
    write_json(run.manifest, {"format_version": 1, "inputs": {"a": "what it was before"}})
    with pytest.raises(SequenceError, match="ingested again since run mixed tracked it"):
        evaluate(in_space.root, "mixed", ["a"])


def test_what_was_made_with_other_settings_is_not_scored(in_space: Dataset) -> None:
    """A run of some sequences, to which one was added with another filter."""
    run = in_space.run("mixed")
    for sequence_id, recipe in (("a", "kalman"), ("b", "hybrid")):
        write_tracks(in_space, "mixed", sequence_id, car_boxes())
        write_json(run.status(sequence_id), {"state": "done", "recipe": recipe})
    write_json(run.manifest, {"format_version": 1, "recipe": "kalman"})
    report = evaluate(in_space.root, "mixed")
    assert set(report.failed) == {"b"}
    assert "made with other settings, weights or code" in report.failed["b"]
