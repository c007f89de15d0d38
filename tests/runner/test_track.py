"""Tracking a dataset: resuming, redoing, failing, being interrupted."""

from __future__ import annotations

import errno
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from safetensors.numpy import save_file

from hbbatch.config import FilterName, TrackSettings
from hbbatch.dataset import Dataset, Run, locked
from hbbatch.errors import DatasetError, ExitStatus, UsageError, WeightsError
from hbbatch.runner import status
from hbbatch.runner.ingest import ingest
from hbbatch.runner.manifest import read_manifest
from hbbatch.runner.track import (
    HYBRIDTRACK,
    TrackReport,
    TrackRequest,
    default_run_name,
    track,
)
from tests.runner.kitti_folder import copy_sequences
from tests.runner.small_dataset import ECHO, catalog_row, load_fails, make_dataset, write_catalog

SETTINGS = TrackSettings()


def run_track(
    dataset: Dataset, *ids: str, settings: TrackSettings = SETTINGS, **options: Any
) -> TrackReport:
    request = TrackRequest(dataset.root, settings, ids, workers=1, device="cpu", **options)
    return track(request, engine=ECHO)


def modified(report: TrackReport) -> dict[Path, int]:
    return {p: p.stat().st_mtime_ns for p in report.path.rglob("*") if p.is_file()}


def test_everything_is_tracked_and_summed_up(tmp_path: Path) -> None:
    report = run_track(make_dataset(tmp_path, "a", "b"))
    assert report.tracked == ("a", "b")
    assert (report.frames, report.detections, report.tracks) == (6, 12, 4)
    assert report.exit_status == ExitStatus.DONE
    assert report.path == tmp_path / "runs" / f"hybrid-{SETTINGS.digest()}"
    timing = pq.read_table(report.path / "timing.parquet")
    assert timing["sequence_id"].to_pylist() == ["a", "b"]
    assert set(read_manifest(Dataset(tmp_path).run(report.run))["inputs"]) == {"a", "b"}


def test_the_same_again_touches_no_file(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    before = modified(run_track(dataset))
    again = run_track(dataset)
    assert (again.tracked, again.up_to_date) == ((), ("a", "b"))
    assert modified(again) == before


def test_a_new_sequence_is_added_to_the_run(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    run_track(dataset, "a")
    report = run_track(dataset)
    assert (report.tracked, report.up_to_date) == (("b",), ("a",))
    timing = pq.read_table(report.path / "timing.parquet")
    assert timing["sequence_id"].to_pylist() == ["a", "b"]


def test_timing_is_read_back_only_of_what_was_tracked_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = make_dataset(tmp_path, "a", "b", "c")
    run_track(dataset, "a")
    run = dataset.run(default_run_name(SETTINGS))
    read = []

    def spy(run: Run, sequence_id: str) -> dict[str, Any]:
        read.append(sequence_id)
        return status.read_status(run, sequence_id)

    monkeypatch.setattr("hbbatch.runner.track.read_status", spy)
    run_track(dataset, "b")
    assert read == ["a", "c"]
    rows = pq.read_table(run.timing).to_pylist()
    assert rows == [status.read_status(run, i)["timing"] for i in "ab"]


def test_a_changed_sequence_is_redone(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    run_track(dataset)
    write_catalog(dataset, catalog_row("a"), catalog_row("b", content_hash="changed"))
    report = run_track(dataset)
    assert (report.tracked, report.outdated, report.up_to_date) == (("b",), ("b",), ("a",))


def test_other_settings_make_another_run(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a")
    first, second = run_track(dataset), run_track(dataset, settings=TrackSettings(min_score=0.1))
    assert first.path != second.path
    assert run_track(dataset).up_to_date == ("a",)


def test_other_settings_under_the_same_name_redo_the_run(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    run_track(dataset, run="mine")
    report = run_track(dataset, run="mine", settings=TrackSettings(min_score=0.9))
    assert report.outdated == ("a", "b")
    assert report.detections == 0
    assert report.odd == ("a, b: no detection of the classes asked for",)


def test_one_bad_sequence_fails_the_run_but_no_other(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    poses = dataset.path("poses", "b")
    kept = poses.read_bytes()
    poses.unlink()
    report = run_track(dataset)
    assert report.tracked == ("a",)
    assert list(report.failed) == ["b"]
    assert report.exit_status == ExitStatus.FAILED
    assert '"state": "failed"' in Dataset(tmp_path).run(report.run).status("b").read_text()
    poses.write_bytes(kept)
    again = run_track(dataset)
    assert (again.tracked, again.up_to_date) == (("b",), ("a",))
    assert again.exit_status == ExitStatus.DONE


def test_a_damaged_source_is_data_loss_also_when_up_to_date(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    rows = catalog_row("a", partial=True, problems=["truncated"]), catalog_row("b")
    write_catalog(dataset, *rows)
    for _ in range(2):
        report = run_track(dataset)
        assert report.partial == ("a",)
        assert report.odd == ("a: truncated",)
        assert report.exit_status == ExitStatus.DATA_LOSS


def test_a_problem_of_many_sequences_is_said_once(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    write_catalog(dataset, *(catalog_row(i, problems=["no oxts"]) for i in "ab"))
    assert run_track(dataset).odd == ("2 sequences: no oxts",)


def test_interrupted_it_keeps_what_was_done_and_goes_on_from_there(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b", "c")

    def interrupt(done: int, total: int) -> None:
        assert total == 9
        if done == 6:
            raise KeyboardInterrupt

    request = TrackRequest(tmp_path, SETTINGS, workers=1)
    with pytest.raises(KeyboardInterrupt):
        track(request, interrupt, ECHO)
    run = dataset.run(default_run_name(SETTINGS))
    # What had ended and waited for the writer is kept as well.
    kept = pq.read_table(run.timing).num_rows
    assert kept >= 2
    assert len(track(request, engine=ECHO).tracked) == 3 - kept


def test_an_unknown_sequence_writes_nothing(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a")
    with pytest.raises(UsageError, match="no such sequence"):
        run_track(dataset, "z")
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("name", ["../outside", "a/b", ".hidden"])
def test_a_run_name_is_no_path(tmp_path: Path, name: str) -> None:
    dataset = make_dataset(tmp_path, "a")
    with pytest.raises(UsageError, match="cannot be a file name"):
        run_track(dataset, run=name)


def test_a_folder_that_cannot_be_written_is_one_error_before_any_work(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a")
    (tmp_path / "runs").write_text("in the way")
    with pytest.raises(DatasetError, match="cannot be written"):
        run_track(dataset)


def test_no_dataset_is_an_error_that_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="hbbatch ingest"):
        run_track(Dataset(tmp_path / "none"))


def test_a_dataset_of_a_newer_version_is_refused(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a")
    table = pq.read_table(dataset.catalog_path)
    metadata = {**table.schema.metadata, b"hbbatch_format_version": b"99"}
    pq.write_table(table.replace_schema_metadata(metadata), dataset.catalog_path)
    with pytest.raises(DatasetError, match="newer hbbatch"):
        run_track(dataset)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (TrackSettings(weights="nowhere.safetensors"), "neither shipped nor a file"),
        (TrackSettings(filter="kalman", classes=("unicorn",)), "unicorn"),
    ],
)
def test_weights_are_checked_before_anything_is_written(
    tmp_path: Path, settings: TrackSettings, message: str
) -> None:
    make_dataset(tmp_path, "a")
    with pytest.raises((WeightsError, UsageError), match=message):
        track(TrackRequest(tmp_path, settings), engine=HYBRIDTRACK)
    assert not (tmp_path / "runs").exists()


def test_damaged_weights_are_named(tmp_path: Path) -> None:
    weights = tmp_path / "w.safetensors"
    weights.write_bytes(b"not safetensors")
    with pytest.raises(WeightsError, match=r"w\.safetensors: no readable safetensors file"):
        HYBRIDTRACK.weights_hash(TrackSettings(weights=str(weights)))


def test_weights_of_another_version_are_named(tmp_path: Path) -> None:
    weights = tmp_path / "w.safetensors"
    header = json.dumps({"version": 99, "of_the_future": True})
    save_file({"x": np.zeros(1)}, weights, {"hbbatch": header})
    with pytest.raises(WeightsError, match=r"w\.safetensors: weights of version 99"):
        HYBRIDTRACK.weights_hash(TrackSettings(weights=str(weights)))


@pytest.mark.usefixtures("kernels")
@pytest.mark.parametrize("name", ["kalman", "hybrid"])
def test_real_tracks_do_not_depend_on_the_number_of_workers(
    test_data: Path, tmp_path: Path, name: FilterName
) -> None:
    source = copy_sequences(test_data, tmp_path / "kitti", "0003", "0012", "0014")
    ingest([source], tmp_path / "data")
    settings = TrackSettings(filter=name)
    reports = [
        track(TrackRequest(tmp_path / "data", settings, run=run, workers=count, device="cpu"))
        for run, count in (("one", 1), ("two", 2))
    ]
    for sequence_id in ("0003", "0012", "0014"):
        one, two = (Dataset(tmp_path / "data").run(r.run).kitti(sequence_id) for r in reports)
        assert one.read_bytes() == two.read_bytes()
        assert len(one.read_text().splitlines()) > 100


def test_a_run_that_another_process_writes_is_left_alone(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a")
    run = dataset.run("mine")
    with locked(run.root), pytest.raises(DatasetError, match="another hbbatch is writing there"):
        run_track(dataset, run="mine")
    assert not list(run.root.iterdir())
    assert run_track(dataset, run="mine").tracked == ("a",)


def test_a_new_run_that_cannot_start_leaves_nothing(tmp_path: Path) -> None:
    """It would be the latest, which `hbbatch eval` takes."""
    dataset = make_dataset(tmp_path, "a")
    request = TrackRequest(dataset.root, TrackSettings(min_score=0.5), workers=1, device="cpu")
    kept = run_track(dataset)
    with pytest.raises(WeightsError):
        track(request, engine=replace(ECHO, load_tracker=load_fails))
    assert dataset.run_names() == [kept.run]
    renewed = replace(request, settings=SETTINGS, run=kept.run)
    dataset.run(kept.run).status("a").unlink()
    with pytest.raises(WeightsError):
        track(renewed, engine=replace(ECHO, load_tracker=load_fails))
    assert dataset.run_names() == [kept.run]


def test_what_is_not_ours_in_a_runs_folder_is_left_alone(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a")
    notes = dataset.run("mine").root / "notes.txt"
    notes.parent.mkdir(parents=True)
    notes.write_text("by hand")
    request = TrackRequest(dataset.root, SETTINGS, run="mine", workers=1, device="cpu")
    with pytest.raises(WeightsError):
        track(request, engine=replace(ECHO, load_tracker=load_fails))
    assert list(notes.parent.iterdir()) == [notes]


def test_the_manifest_names_what_was_asked_for_last(tmp_path: Path) -> None:
    """All with some settings, one with others, another with the first again, or a failed start."""
    dataset = make_dataset(tmp_path, "a", "b")
    other = TrackSettings(min_score=0.5)
    run_track(dataset, run="mine")
    recipe = read_manifest(dataset.run("mine"))["recipe"]
    run_track(dataset, "a", run="mine", settings=other)
    assert read_manifest(dataset.run("mine"))["recipe"] != recipe
    assert run_track(dataset, "b", run="mine").up_to_date == ("b",)
    assert read_manifest(dataset.run("mine"))["recipe"] == recipe
    request = TrackRequest(dataset.root, other, ("b",), "mine", "cpu", 1)
    with pytest.raises(WeightsError):
        track(request, engine=replace(ECHO, load_tracker=load_fails))
    assert read_manifest(dataset.run("mine"))["recipe"] == recipe


def test_on_a_full_disk_the_sequences_that_failed_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    renamed = Path.replace

    def full(path: Path, target: Path) -> Path:
        if "a.txt" in target.name or "timing" in target.name:
            raise OSError(errno.ENOSPC, "No space left on device")
        return renamed(path, target)

    monkeypatch.setattr(Path, "replace", full)
    report = run_track(dataset)
    assert report.tracked == ("b",)
    assert "No space left on device" in report.failed["a"]
    with pytest.raises(DatasetError, match=r"timing\.parquet: cannot be written"):
        run_track(dataset, "b", run="other")


def test_a_status_without_timing_is_no_row_of_the_timing_table(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    run_track(dataset, run="mine")
    dataset.run("mine").status("a").write_text('{"state": "done"}')
    run_track(dataset, "b", run="mine", settings=TrackSettings(min_score=0.5))
    assert pq.read_table(dataset.run("mine").timing)["sequence_id"].to_pylist() == ["b"]
