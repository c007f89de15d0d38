"""What the user sees of an ingest: a table, warnings, errors and the exit status."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hbbatch.cli.main import app
from tests import logs
from tests.kitti_folders import calibration_text, write_sequence


def hbbatch(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hbbatch", *map(str, arguments)]
    environment = {k: v for k, v in os.environ.items() if k != "HBBATCH_DATASET"}
    return subprocess.run(
        command, cwd=cwd, capture_output=True, text=True, env=environment, check=False
    )


def test_table_says_what_was_written_where(tmp_path: Path) -> None:
    source = write_sequence(tmp_path / "kitti")
    result = hbbatch("ingest", source, cwd=tmp_path)
    assert result.returncode == 0
    assert result.stderr == ""
    header, row, summary = result.stdout.splitlines()
    assert header.split() == [
        "sequence",
        "status",
        "frames",
        "detections",
        "labels",
        "seconds",
        "poses",
    ]
    assert row.split()[:5] == ["0000", "ingested", "3", "3", "0"]
    assert summary.startswith("1 ingested in ")
    assert summary.endswith("dataset hbbatch_data")
    assert (tmp_path / "hbbatch_data" / "catalog.parquet").is_file()


def test_json_is_all_there_is_on_stdout(tmp_path: Path) -> None:
    source = write_sequence(write_sequence(tmp_path / "kitti"), "0001", oxts="")
    result = hbbatch("ingest", source, "-d", "out", "--json", cwd=tmp_path)
    content = json.loads(result.stdout)
    good, bad = content["sequences"]
    assert (good["sequence_id"], good["status"], good["frames"]) == ("0000", "ingested", 3)
    assert (bad["sequence_id"], bad["status"]) == ("0001", "failed")
    assert content["errors"] == [bad["error"]]
    assert result.returncode == 1


def test_the_same_warning_of_many_sequences_is_given_once(tmp_path: Path) -> None:
    source = tmp_path / "kitti"
    for name in ("0000", "0001", "0002"):
        write_sequence(source, name)
        (source / "oxts" / f"{name}.txt").unlink()
    result = hbbatch("ingest", source, cwd=tmp_path)
    assert result.returncode == 0
    [warning] = result.stderr.splitlines()
    assert warning.startswith("warning: 3 sequences (0000, …): no oxts")


@pytest.mark.parametrize(
    ("calibration", "expected"),
    [(None, 0), (calibration_text(P2=""), 1)],
)
def test_exit_status_of_bad_input(tmp_path: Path, calibration: str | None, expected: int) -> None:
    result = hbbatch(
        "ingest", write_sequence(tmp_path / "kitti", calibration=calibration), cwd=tmp_path
    )
    assert result.returncode == expected
    assert "Traceback" not in result.stderr
    assert len(result.stderr.splitlines()) == expected


def test_exit_status_of_lost_data(tmp_path: Path) -> None:
    item = logs.detection((1, 2, 3, -4, 2, 1, 0), [("car", 0.5)])
    log = logs.LogWriter().add("/d", 0, logs.detections(10**9, "map", [item]))
    result = hbbatch("ingest", log.write(tmp_path / "drive.mcap"), cwd=tmp_path)
    assert result.returncode == 3
    assert "ingested, partial" in result.stdout
    assert result.stderr.startswith("warning: sequence drive: topic /d: 1 boxes left out")


def test_several_topics_and_no_choice(tmp_path: Path) -> None:
    log = logs.LogWriter()
    for topic in ("/a", "/b"):
        log.add(topic, 0, logs.detections(10**9, "map", []))
    path = log.write(tmp_path / "drive.mcap")
    refused = hbbatch("ingest", path, cwd=tmp_path)
    assert refused.returncode == 2
    assert "several detection topics (/a, /b). Use --topic." in refused.stderr
    assert hbbatch("ingest", path, "--topic", "/a", cwd=tmp_path).returncode == 0


def test_unwritable_dataset_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    source = write_sequence(tmp_path / "kitti")
    result = hbbatch("ingest", source, "-d", tmp_path / "file", cwd=tmp_path)
    assert result.returncode == 1
    [error] = result.stderr.splitlines()
    assert error.startswith(f"error: {tmp_path}/file/catalog.parquet: cannot be written")


def test_a_source_that_must_not_be_read_stops_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command line takes it; what it costs is the reader's to say."""
    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    source = write_sequence(tmp_path / "kitti")
    result = CliRunner().invoke(app, ["ingest", str(source), "-d", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output


def test_no_source_is_a_usage_error(tmp_path: Path) -> None:
    assert hbbatch("ingest", cwd=tmp_path).returncode == 2


def test_damaged_logs_of_a_folder_are_an_error_each_and_stop_no_other(tmp_path: Path) -> None:
    folder = tmp_path / "drives"
    folder.mkdir()
    logs.LogWriter().add("/d", 0, logs.detections(10**9, "map", [])).write(folder / "drive.mcap")
    (folder / "zero.mcap").touch()
    (folder / "junk.mcap").write_bytes(bytes(range(200)))
    (folder / "notes.txt").write_text("no log")
    result = hbbatch("ingest", folder, cwd=tmp_path)
    assert result.returncode == 1
    assert "1 ingested" in result.stdout
    junk, zero = result.stderr.splitlines()
    assert junk.startswith(f"error: {folder}/junk.mcap: an unknown format")
    assert zero.startswith(f"error: {folder}/zero.mcap: an empty file")


def test_many_equal_errors_are_one_line(tmp_path: Path) -> None:
    for name in ("0000", "0001", "0002"):
        source = write_sequence(tmp_path / "kitti", name, calibration=calibration_text(P2=""))
    result = hbbatch("ingest", source, cwd=tmp_path)
    [error] = result.stderr.splitlines()
    assert "calib/0000.txt: P2 is missing" in error
    assert "(and 2 more like it; see --json)" in error


def test_json_names_sources_by_absolute_paths(tmp_path: Path) -> None:
    write_sequence(write_sequence(tmp_path / "kitti"), "0001", oxts="")
    result = hbbatch("ingest", "kitti", "--json", cwd=tmp_path)
    paths = {sequence["source"] for sequence in json.loads(result.stdout)["sequences"]}
    assert paths == {str(tmp_path / "kitti")}
