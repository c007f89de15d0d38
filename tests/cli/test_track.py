"""`hbbatch track` as it is typed, on a dataset of a few boxes with the classical filter."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from hbbatch.cli.main import app
from hbbatch.dataset import Dataset
from hbbatch.errors import HbbatchError
from tests.runner.small_dataset import catalog_row, make_dataset, write_catalog

KALMAN = ("--filter", "kalman", "--workers", "1", "--device", "cpu")


def hbbatch_track(dataset: Path, *arguments: str) -> Result:
    return CliRunner().invoke(app, ["track", "-d", str(dataset), *KALMAN, *arguments])


def test_the_summary_goes_to_stdout_and_nothing_to_stderr(tmp_path: Path) -> None:
    make_dataset(tmp_path, "a", "b", frames=5)
    result = hbbatch_track(tmp_path)
    assert result.exit_code == 0
    assert result.stderr == ""
    for part in (
        "2 tracked, 0 up to date, 0 failed",
        "frames per s",
        "timing.parquet",
        "time split",
    ):
        assert part in result.stdout


def test_without_a_score_scale_weak_boxes_are_written_and_that_is_said(tmp_path: Path) -> None:
    make_dataset(tmp_path, "a")
    assert "`hbbatch calibrate`" in hbbatch_track(tmp_path).stdout
    config = tmp_path / "detector.yaml"
    config.write_text("output: {score_scale: {car: {typical: 0.5, strong: 0.9}}}")
    assert "calibrate" not in hbbatch_track(tmp_path, "--config", str(config)).stdout


def test_nothing_to_do_is_said(tmp_path: Path) -> None:
    make_dataset(tmp_path, "a")
    hbbatch_track(tmp_path)
    result = hbbatch_track(tmp_path)
    assert result.exit_code == 0
    assert "nothing to do" in result.stdout


def test_json_is_all_there_is_on_stdout(tmp_path: Path) -> None:
    make_dataset(tmp_path, "a", "b")
    report = json.loads(hbbatch_track(tmp_path, "--json", "--run", "mine", "b").stdout)
    assert report["run"] == "mine"
    assert report["tracked"] == ["b"]
    assert report["frames"] == 3
    assert report["device"] == "cpu"
    assert report["exit_status"] == 0


def test_a_failed_sequence_is_a_line_on_stderr_and_status_1(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    dataset.path("detections", "b").unlink()
    result = hbbatch_track(tmp_path)
    assert result.exit_code == 1
    assert result.stderr.startswith("error: sequence b: detections of sequence b")
    assert result.stderr.count("\n") == 1
    assert "1 tracked, 0 up to date, 1 failed" in result.stdout


def test_data_loss_is_status_3(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a")
    write_catalog(dataset, catalog_row("a", partial=True, problems=["log ends early"]))
    result = hbbatch_track(tmp_path)
    assert result.exit_code == 3
    assert "a: log ends early" in result.stdout


def test_options_reach_the_settings(tmp_path: Path) -> None:
    make_dataset(tmp_path, "a")
    config = tmp_path / "c.yaml"
    config.write_text("min_score: 0.1\noutput: {max_coasted: 3}\n")
    arguments = ("--config", str(config), "--class", "car", "--class", "van", "--min-score", "0.2")
    arguments = (*arguments, "--protocol", "online")
    hbbatch_track(tmp_path, *arguments, "--run", "r")
    settings = json.loads(Dataset(tmp_path).run("r").manifest.read_text())["settings"]
    assert settings["filter"] == "kalman"
    assert settings["classes"] == ["car", "van"]
    assert settings["min_score"] == 0.2
    assert settings["output"]["protocol"] == "online"


def test_an_installation_without_a_compiler_is_told_what_it_costs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_dataset(tmp_path, "a")
    assert "C compiler" not in hbbatch_track(tmp_path, "--workers", "1", "--run", "r").stdout
    monkeypatch.setattr("hbbatch.packed.kernels.AVAILABLE", False)
    assert "C compiler" in hbbatch_track(tmp_path, "--workers", "1", "--run", "s").stdout


def test_an_unknown_sequence_is_a_usage_error(tmp_path: Path) -> None:
    make_dataset(tmp_path, "a")
    result = hbbatch_track(tmp_path, "z")
    assert isinstance(result.exception, HbbatchError)
    assert result.exception.exit_status == 2


@pytest.fixture
def _interruptible() -> Iterator[None]:
    """Processes started now heed Ctrl-C, also where this one was started in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupt(process: subprocess.Popen[str]) -> None:
    """As a terminal does: the whole process group."""
    os.killpg(process.pid, signal.SIGINT)


def terminate(process: subprocess.Popen[str]) -> None:
    """As a scheduler does: the command alone."""
    process.terminate()


@pytest.mark.usefixtures("_interruptible")
@pytest.mark.parametrize(("end", "status"), [(interrupt, 130), (terminate, 143)])
def test_a_run_that_is_ended_leaves_nothing_half_written_and_no_word_but_one(
    tmp_path: Path, end: Callable[[subprocess.Popen[str]], None], status: int
) -> None:
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    make_dataset(tmp_path, "a", "b", "c", frames=30_000)
    arguments = ["track", "-d", str(tmp_path), "--filter", "kalman", "--workers", "2"]
    process = subprocess.Popen(
        [sys.executable, "-m", "hbbatch", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "TMPDIR": str(temporary)},
    )
    while not list(tmp_path.glob("runs/*/run.json")):
        assert process.poll() is None
    end(process)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == status
    assert errors.strip() == (
        "interrupted: sequences that had ended are kept, the same command goes on"
    )
    assert not list(tmp_path.rglob("*.partial"))
    assert not list(temporary.iterdir())


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--min-score", "nan"), "min_score: Input should be a finite number"),
        (("--min-score", "inf"), "min_score: Input should be a finite number"),
        (("--run", ""), "run name ''"),
    ],
)
def test_what_cannot_be_a_setting_or_name_is_a_usage_error(
    tmp_path: Path, arguments: tuple[str, str], expected: str
) -> None:
    make_dataset(tmp_path, "a")
    result = hbbatch_track(tmp_path, *arguments)
    assert isinstance(result.exception, HbbatchError)
    assert result.exception.exit_status == 2
    assert expected in str(result.exception)
    assert not (tmp_path / "runs").exists()


def test_the_manifest_says_what_defaults_came_to(tmp_path: Path) -> None:
    make_dataset(tmp_path, "a")
    arguments = ["track", "-d", str(tmp_path), "--filter", "kalman", "--workers", "1", "--run", "r"]
    CliRunner().invoke(app, arguments)
    manifest = json.loads(Dataset(tmp_path).run("r").manifest.read_text())
    assert manifest["weights"]["name"] == "kitti-kalman"
    assert len(manifest["weights"]["hash"]) == 64
    assert "car" in manifest["settings"]["classes"]
    assert manifest["settings"]["association"]["max_cost"] == 1.2
    assert manifest["device"] in ("cpu", "cuda")


def test_classes_may_be_spelled_as_a_data_set_does(tmp_path: Path) -> None:
    make_dataset(tmp_path, "a")
    as_recorded = hbbatch_track(tmp_path, "--class", "person_sitting", "--class", "car")
    spelled = hbbatch_track(tmp_path, "--class", "Person sitting", "--class", "Car")
    assert (as_recorded.exit_code, spelled.exit_code) == (0, 0)
    assert "nothing to do" in spelled.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ("--weights", "nosuch"),
        ("--weights", "kitti"),
        ("--class", "unicorn"),
        ("--config", "/nosuch.yaml"),
        ("--device", "cuda"),
    ],
)
def test_what_is_not_there_or_does_not_fit_is_a_usage_error(
    tmp_path: Path, arguments: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hbbatch.runner.device.driver_found", lambda: False)
    make_dataset(tmp_path, "a")
    result = hbbatch_track(tmp_path, *arguments)
    assert isinstance(result.exception, HbbatchError)
    assert result.exception.exit_status == 2
