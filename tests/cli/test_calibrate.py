"""`hbbatch calibrate` as it is typed."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner

from hbbatch.cli.main import app
from hbbatch.errors import UsageError
from tests.runner.small_dataset import make_dataset


def test_the_settings_to_track_with_are_not_written_over(tmp_path: Path) -> None:
    root = make_dataset(tmp_path / "data", "a").root
    mine = tmp_path / "mine.yaml"
    mine.write_text("filter: kalman\n")
    typed = ["calibrate", str(mine), "-d", str(root), "--config", str(mine)]
    result = CliRunner().invoke(app, typed)
    assert isinstance(result.exception, UsageError)
    assert "would be written over" in str(result.exception)
    assert mine.read_text() == "filter: kalman\n"
