"""A job, again and again, on three real sequences of which one has labels."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from hbbatch.config import TrackSettings
from hbbatch.dataset import Dataset
from hbbatch.errors import ExitStatus
from hbbatch.runner.jobfile import RelabelJob, SourceJob
from hbbatch.runner.orders import LoadTracker
from hbbatch.runner.relabel import RelabelReport, relabel
from hbbatch.runner.track import HYBRIDTRACK, Engine
from tests import logs
from tests.runner.kitti_folder import copy_sequences


@pytest.fixture
def job(test_data: Path, tmp_path: Path) -> RelabelJob:
    source = copy_sequences(test_data, tmp_path / "kitti", "0003", "0012", "0014")
    return RelabelJob(
        dataset=tmp_path / "data",
        sources=(SourceJob(path=source),),
        track=TrackSettings(filter="kalman"),
        workers=1,
        device="cpu",
    )


def forbidden(*_: object) -> None:
    raise AssertionError("nothing should be tracked")


def idle(job: RelabelJob) -> RelabelReport:
    """Run a job that must not track anything."""
    load: LoadTracker = forbidden  # type: ignore[assignment]
    return relabel(job, engine=replace(HYBRIDTRACK, load_tracker=load))


def modified(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


def test_a_job_ingests_tracks_and_scores_and_then_has_nothing_to_do(job: RelabelJob) -> None:
    first = relabel(job)
    assert first.exit_status == ExitStatus.DONE
    assert not first.unchanged
    assert first.tracked is not None
    assert first.tracked.tracked == ("0003", "0012", "0014")
    assert first.evaluated is not None
    assert first.evaluated.evaluation.classes["car"].combined.hota > 60
    scores = json.loads((first.tracked.path / "evaluation.json").read_text())
    assert scores["classes"]["car"]["combined"]["hota"] > 60

    before = modified(job.dataset)
    again = idle(job)
    assert again.unchanged
    assert again.exit_status == ExitStatus.DONE
    assert modified(job.dataset) == before
    json.dumps(first.to_json())
    json.dumps(again.to_json())


def test_only_what_changed_is_done_again(job: RelabelJob) -> None:
    quick = job.model_copy(update={"evaluate": False})
    relabel(quick)
    oxts = job.sources[0].path / "oxts/0012.txt"
    lines = oxts.read_text().splitlines()
    oxts.write_text("\n".join([lines[0], *lines[:-1]]) + "\n")
    report = relabel(quick)
    assert report.tracked is not None
    assert report.tracked.tracked == ("0012",)
    assert report.tracked.up_to_date == ("0003", "0014")


def test_changed_labels_are_scored_again_without_tracking(job: RelabelJob) -> None:
    relabel(job)
    labels = job.sources[0].path / "label_02/0003.txt"
    labels.write_text("\n".join(labels.read_text().splitlines()[:-1]) + "\n")
    report = idle(job)
    assert report.evaluated is not None
    assert not report.unchanged


def test_a_source_without_anything_fails_the_job_but_not_the_others(job: RelabelJob) -> None:
    empty = job.dataset.parent / "empty"
    empty.mkdir()
    sources = (SourceJob(path=empty), *job.sources)
    report = relabel(job.model_copy(update={"sources": sources, "evaluate": False}))
    assert report.exit_status == ExitStatus.FAILED
    assert any(str(empty) in error for error in report.errors)
    assert len(Dataset(job.dataset).sequence_ids()) == 3
    assert report.tracked is not None
    assert len(report.tracked.tracked) == 3


def test_a_job_that_finds_nothing_tracks_nothing(job: RelabelJob) -> None:
    empty = job.dataset.parent / "empty"
    empty.mkdir()
    engine = Engine(forbidden, forbidden, forbidden)  # type: ignore[arg-type]
    report = relabel(job.model_copy(update={"sources": (SourceJob(path=empty),)}), engine=engine)
    assert report.tracked is None
    assert report.exit_status == ExitStatus.FAILED
    assert not job.dataset.exists()


def test_a_topic_that_is_nowhere_is_a_usage_error_as_it_is_of_ingest(tmp_path: Path) -> None:
    log = logs.LogWriter()
    log.add("/d", 0, logs.detections(1_000_000_000, "map", []))
    source = SourceJob(path=log.write(tmp_path / "drive.mcap"), topics=("/nowhere",))
    report = relabel(RelabelJob(dataset=tmp_path / "data", sources=(source,)))
    assert report.exit_status == ExitStatus.USAGE
    assert any("/nowhere" in error for error in report.errors)
