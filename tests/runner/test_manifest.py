"""run.json."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest

from hbbatch.config import TrackSettings
from hbbatch.dataset import Run
from hbbatch.errors import DatasetError
from hbbatch.runner.manifest import read_manifest, write_manifest
from hbbatch.runner.plan import code_version

SETTINGS = TrackSettings(filter="kalman", min_score=0.5)


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run(tmp_path / "runs" / "r")


def write(run: Run, inputs: dict[str, str]) -> None:
    write_manifest(
        run, SETTINGS, "recipe", "w", inputs, {"command": "hbbatch track", "device": "cpu"}
    )


def test_it_says_what_a_run_was_made_from(run: Run) -> None:
    write(run, {"a": "content of a"})
    manifest = read_manifest(run)
    assert TrackSettings.model_validate(manifest["settings"]) == SETTINGS
    assert manifest["weights"] == {"name": None, "hash": "w"}
    assert manifest["code_version"] == code_version()
    assert manifest["command"] == "hbbatch track"
    assert {"numpy", "pyarrow", "torch"} <= set(manifest["versions"])
    assert socket.gethostname() not in run.manifest.read_text()


def test_renewing_keeps_what_was_there_before(run: Run) -> None:
    write(run, {"a": "1", "b": "1"})
    created = read_manifest(run)["created"]
    write(run, {"b": "2"})
    assert read_manifest(run)["inputs"] == {"a": "1", "b": "2"}
    assert read_manifest(run)["created"] == created


def test_a_run_of_a_newer_version_is_refused(run: Run) -> None:
    write(run, {})
    run.manifest.write_text(json.dumps({**read_manifest(run), "format_version": 99}))
    with pytest.raises(DatasetError, match=r"newer hbbatch \(format 99.*Upgrade"):
        read_manifest(run)


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"format_version": "x"}'])
def test_a_damaged_manifest_is_named(run: Run, content: str) -> None:
    write(run, {})
    run.manifest.write_text(content)
    with pytest.raises(DatasetError, match=r"run\.json: not a readable run manifest"):
        read_manifest(run)
