"""`hbbatch relabel` as it is typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from hbbatch.cli.main import app
from hbbatch.errors import ConfigError
from hbbatch.runner.jobfile import load_job
from tests.runner.kitti_folder import copy_sequences

PIPELINES = Path(__file__).parents[2] / "pipelines"


def hbbatch_relabel(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["relabel", *arguments])


@pytest.fixture
def job(test_data: Path, tmp_path: Path) -> str:
    copy_sequences(test_data, tmp_path / "kitti", "0012")
    path = tmp_path / "job.yaml"
    path.write_text("dataset: data\nsources: [{path: kitti}]\ntrack: {filter: kalman}\n")
    return str(path)


def test_a_job_runs_and_then_says_that_nothing_changed(job: str) -> None:
    first = hbbatch_relabel(job)
    assert first.exit_code == 0
    assert "1 ingested" in first.stdout
    assert "1 tracked" in first.stdout
    second = hbbatch_relabel(job)
    assert second.exit_code == 0
    assert "Nothing has changed since the last time" in second.stdout
    assert json.loads(hbbatch_relabel(job, "--json").stdout)["unchanged"] is True


def test_weak_boxes_are_told_of_unless_the_scale_of_scores_is_known(job: str) -> None:
    notice = "Weak boxes are written as well"
    assert notice in hbbatch_relabel(job).stdout
    path = Path(job)
    scale = "output: {score_scale: {car: {typical: 3.4, strong: 5.9}}}"
    path.write_text(path.read_text().replace("{filter: kalman}", f"{{filter: kalman, {scale}}}"))
    assert notice not in hbbatch_relabel(job).stdout


def test_a_bad_job_starts_nothing(job: str) -> None:
    path = Path(job)
    path.write_text(path.read_text() + "speed: 11\n")
    result = hbbatch_relabel(job)
    assert isinstance(result.exception, ConfigError)
    assert not (path.parent / "data").exists()


@pytest.mark.parametrize("name", ["kitti.yaml", "mcap.yaml"])
def test_the_jobs_of_the_repository_are_valid(
    name: str, test_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("KITTI_TRACKING", str(test_data / "kitti"))
    monkeypatch.setenv("DRIVES", str(tmp_path))
    job = load_job(PIPELINES / name)
    assert job.dataset == PIPELINES.parent / "hbbatch_data"
