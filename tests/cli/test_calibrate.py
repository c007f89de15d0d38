"""`hbbatch calibrate` as it is typed."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner

from hbbatch.cli.main import app
from hbbatch.errors import UsageError
from tests.runner.small_dataset import make_dataset
from tests.tracking.real_drives import few_drives


def test_the_settings_to_track_with_are_not_written_over(tmp_path: Path) -> None:
    root = make_dataset(tmp_path / "data", "a").root
    mine = tmp_path / "mine.yaml"
    mine.write_text("filter: kalman\n")
    typed = ["calibrate", str(mine), "-d", str(root), "--config", str(mine)]
    result = CliRunner().invoke(app, typed)
    assert isinstance(result.exception, UsageError)
    assert "would be written over" in str(result.exception)
    assert mine.read_text() == "filter: kalman\n"


def test_weights_of_several_detectors_are_not_sent_to_track_without_a_scale(
    test_data: Path, tmp_path: Path
) -> None:
    roots = [few_drives(test_data, "0000", "0003", "0005").root] * 2
    typed = ["calibrate", str(tmp_path / "shared.yaml"), "--from-labels"]
    result = CliRunner().invoke(app, [*typed, *(part for r in roots for part in ("-d", str(r)))])
    assert result.exit_code == 0
    assert "Next: add the output.score_scale" in result.stdout
