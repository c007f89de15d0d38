"""Job files are checked as a whole, before anything starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from hbbatch.errors import ConfigError
from hbbatch.runner.jobfile import load_job

GOOD = """
dataset: out
sources:
  - path: drives
    detections: ${DETECTIONS:-boxes}
track: {filter: kalman}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("drives", "boxes", "other"):
        (tmp_path / name).mkdir()
    return tmp_path


def write(folder: Path, text: str) -> Path:
    path = folder / "job.yaml"
    path.write_text(text)
    return path


def test_paths_are_relative_to_the_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir("/")
    job = load_job(write(folder, GOOD))
    assert job.dataset == folder / "out"
    assert job.sources[0].path == folder / "drives"
    assert job.sources[0].detections == folder / "boxes"


def test_variables_come_from_the_environment(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DETECTIONS", "other")
    assert load_job(write(folder, GOOD)).sources[0].detections == folder / "other"


def test_a_variable_without_value_and_default_is_named(folder: Path) -> None:
    with pytest.raises(ConfigError, match="environment variable NOWHERE_SET is not set"):
        load_job(write(folder, GOOD.replace("drives", "${NOWHERE_SET}")))


def test_all_faults_are_told_at_once(folder: Path) -> None:
    text = GOOD.replace("drives", "gone").replace("boxes", "lost") + "run: a/b\n"
    with pytest.raises(ConfigError) as caught:
        load_job(write(folder, text))
    for part in ("gone does not exist", "lost does not exist", "run name 'a/b'"):
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (GOOD + "worker: 3\n", "worker: unknown setting; known are dataset, sources, track"),
        (GOOD + 'run: ""\n', "run name ''"),
        (GOOD.replace("kalman", "particle"), "track.filter"),
        (GOOD + "workers: 0\n", "workers"),
        ("dataset: out\nsources: []\n", "sources"),
        ("sources: [{path: drives}]\n", "dataset: Field required"),
        ("[1, 2]", "expected a mapping"),
        ("a: [", "not valid YAML"),
        (GOOD.replace("kalman", "kalman, weights: no.safetensors"), "no.safetensors"),
    ],
)
def test_a_fault_is_named(folder: Path, text: str, named: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_job(write(folder, text))
    assert named in str(caught.value)
    assert "job.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_job_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"job\.yaml: cannot be read"):
        load_job(tmp_path / "job.yaml")
