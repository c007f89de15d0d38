"""Folders of sources: what became of a sequence that left, names told apart, exit statuses."""

from __future__ import annotations

from pathlib import Path

import pytest
import zstandard

from hbbatch.dataset import Dataset
from hbbatch.errors import ExitStatus
from hbbatch.runner.ingest import IngestReport, ingest
from hbbatch.sources.base import SourceOptions
from tests import logs
from tests.kitti_folders import write_sequence

SECOND = 1_000_000_000


def write_log(path: Path, *topics: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    log = logs.LogWriter()
    for topic in topics or ("/d",):
        log.add(topic, 0, logs.detections(SECOND, "map", []))
    return log.write(path)


def statuses(report: IngestReport) -> dict[str, str]:
    return {outcome.sequence_id: outcome.status.value for outcome in report.outcomes}


def remove_kitti_sequence(source: Path, sequence_id: str) -> None:
    for path in source.glob(f"*/{sequence_id}.txt"):
        path.unlink()


# --- sequences that left -----------------------------------------------------


def test_a_sequence_that_left_its_source_leaves_the_dataset_and_is_named(tmp_path: Path) -> None:
    source = write_sequence(write_sequence(tmp_path / "kitti"), "0001")
    other = write_log(tmp_path / "drive.mcap")
    ingest([source, other], tmp_path / "out")
    remove_kitti_sequence(source, "0001")
    report = ingest([source], tmp_path / "out")
    dataset = Dataset.open(tmp_path / "out")
    assert dataset.sequence_ids() == ["0000", "drive"]
    assert not dataset.path("poses", "0001").exists()
    assert report.dropped == {source: ["0001"]}
    assert report.notices[0].startswith(f"{source} does not hold 0001 any more: removed")
    assert report.exit_status is ExitStatus.DONE
    assert ingest([source], tmp_path / "out").dropped == {}


def test_a_sequence_that_fails_has_not_left(tmp_path: Path) -> None:
    source = write_sequence(write_sequence(tmp_path / "kitti"), "0001")
    ingest([source], tmp_path / "out")
    (source / "calib" / "0001.txt").write_text("garbage")
    report = ingest([source], tmp_path / "out")
    assert report.dropped == {}
    assert Dataset.open(tmp_path / "out").sequence_ids() == ["0000", "0001"]


def test_other_topics_of_a_log_have_not_left(tmp_path: Path) -> None:
    log = write_log(tmp_path / "drive.mcap", "/a", "/b")
    ingest([log], tmp_path / "out", options=SourceOptions(topics=("/a", "/b")))
    ingest([log], tmp_path / "out", options=SourceOptions(topics=("/a",)))
    assert Dataset.open(tmp_path / "out").sequence_ids() == ["drive", "drive-a", "drive-b"]


# --- names told apart -----------------------------------------------------


def test_logs_of_the_same_name_are_named_with_their_folders(tmp_path: Path) -> None:
    for name in ("drive.mcap", "a/drive.mcap", "b/c/drive.mcap", "b/other.mcap"):
        write_log(tmp_path / "logs" / name)
    ingested = statuses(ingest([tmp_path / "logs"], tmp_path / "out"))
    assert ingested == dict.fromkeys(("a-drive", "b-c-drive", "other", "drive"), "ingested")
    again = statuses(ingest([tmp_path / "logs"], tmp_path / "out"))
    assert again == dict.fromkeys(ingested, "unchanged")


def test_logs_of_the_same_name_given_side_by_side(tmp_path: Path) -> None:
    paths = [write_log(tmp_path / name) for name in ("a/drive.mcap", "b/c/drive.mcap", "b/x.mcap")]
    ingested = statuses(ingest(paths, tmp_path / "out"))
    assert ingested == dict.fromkeys(("a-drive", "b-c-drive", "x"), "ingested")
    again = statuses(ingest(paths[::-1], tmp_path / "out"))
    assert again == dict.fromkeys(ingested, "unchanged")


def test_folders_given_side_by_side_that_name_their_logs_alike(tmp_path: Path) -> None:
    days = [tmp_path / "mon", tmp_path / "tue"]
    for day in days:
        write_log(day / "a" / "drive.mcap")
        write_log(day / "b" / "drive.mcap")
    ingested = statuses(ingest(days, tmp_path / "out"))
    assert ingested == dict.fromkeys(
        ("mon-a-drive", "mon-b-drive", "tue-a-drive", "tue-b-drive"), "ingested"
    )


def test_logs_of_the_same_name_in_one_folder_collide(tmp_path: Path) -> None:
    one, other = write_log(tmp_path / "drive.mcap"), tmp_path / "drive.mcap.zstd"
    other.write_bytes(zstandard.compress(one.read_bytes()))
    report = ingest([one, other], tmp_path / "out")
    assert [outcome.status.value for outcome in report.outcomes] == ["ingested", "failed"]
    assert f"sequence drive is also in {one}" in report.errors[0]


def test_names_of_any_alphabet_are_told_apart(tmp_path: Path) -> None:
    for name in ("日本", "東京", "Zürich früh"):
        write_log(tmp_path / "logs" / f"{name}.mcap")
    names = sorted(statuses(ingest([tmp_path / "logs"], tmp_path / "out")))
    assert names[0] == "Zurich-fruh"
    assert [name.partition("-")[0] for name in names[1:]] == ["unnamed", "unnamed"]
    assert len(set(names)) == 3


# --- what was asked for is not there -----------------------------------------------------


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (SourceOptions(), "several detection topics"),
        (SourceOptions(topics=("/nosuch",)), "no detections on /nosuch"),
    ],
)
def test_a_choice_that_does_not_fit_is_a_usage_error(
    tmp_path: Path, options: SourceOptions, expected: str
) -> None:
    report = ingest([write_log(tmp_path / "d.mcap", "/a", "/b")], tmp_path / "o", options=options)
    assert expected in report.errors[0]
    assert report.exit_status is ExitStatus.USAGE


def test_detections_folder_that_is_not_there(tmp_path: Path) -> None:
    source = write_sequence(tmp_path / "kitti")
    nowhere = tmp_path / "nosuch"
    report = ingest([source], tmp_path / "out", options=SourceOptions(nowhere))
    assert report.errors == [f"{nowhere}: does not exist. Check --detections."]
    assert report.exit_status is ExitStatus.USAGE


def test_links_that_lead_nowhere_or_in_circles(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    write_log(folder / "drive.mcap")
    (folder / "again").symlink_to(folder)
    (folder / "gone.mcap").symlink_to(tmp_path / "nowhere.mcap")
    (folder / "self.mcap").symlink_to(folder / "self.mcap")
    report = ingest([folder], tmp_path / "out")
    assert statuses(report) == {"drive": "ingested"}
    for error, name in zip(report.errors, ("gone.mcap", "self.mcap"), strict=True):
        assert error.startswith(f"{folder / name}: a link to nothing.")


def test_a_damaged_source_beside_a_missing_one_is_a_failure(tmp_path: Path) -> None:
    (tmp_path / "zero.mcap").touch()
    report = ingest([tmp_path / "nowhere", tmp_path / "zero.mcap"], tmp_path / "out")
    assert len(report.errors) == 2
    assert report.exit_status is ExitStatus.FAILED
