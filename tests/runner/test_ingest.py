"""Sources into the dataset: tables, what is done again, and what one failure costs."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from hbbatch import schema
from hbbatch.dataset import Dataset
from hbbatch.errors import DatasetError, ExitStatus, SourceError
from hbbatch.runner import ingest_task
from hbbatch.runner.ingest import IngestReport, ingest
from hbbatch.sources.base import FrameBatch, SourceOptions
from tests import logs
from tests.kitti_folders import CAR, calibration_text, write_sequence

SECOND = 1_000_000_000
LABELS = f"0 -1 DontCare -1 -1 -10 5 5 9 9 -1000 -1000 -1000 -10 -1 -1 -1\n1 7 {CAR}\n"


def statuses(report: IngestReport) -> dict[str, str]:
    return {outcome.sequence_id: outcome.status.value for outcome in report.outcomes}


def files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def write_drive(path: Path, detections: int = 3, damage: bool = False) -> Path:
    log = logs.LogWriter()
    for k in range(detections):
        box = (10.0, 2.0, 0.5, -4.0 if damage and not k else 4.0, 2.0, 1.5, 0.3)
        item = logs.detection(box, [("car", 0.9)])
        log.add("/d", k, logs.detections((k + 1) * SECOND, "map", [item]))
    return log.write(path)


# --- what is written ----------------------------------------------------------------------------


def test_tables_of_a_sequence(tmp_path: Path) -> None:
    source = write_sequence(tmp_path / "kitti", labels=LABELS)
    report = ingest([source], tmp_path / "out")
    dataset = Dataset.open(tmp_path / "out")
    detections, poses, labels = (
        dataset.detections("0000"),
        dataset.poses("0000"),
        dataset.labels("0000"),
    )
    assert detections["frame_index"].to_pylist() == [0, 1, 2]
    assert detections["detection_id"].to_pylist() == [0, 1, 2]
    assert detections["class_name"].to_pylist() == ["car"] * 3
    assert detections["class_name_logged"].to_pylist() == ["Car"] * 3
    assert detections["source_row"].to_pylist() == [0, 1, 2]
    assert poses["timestamp_ns"].to_pylist() == [0, SECOND // 10, 2 * SECOND // 10]
    assert poses["log_time_ns"].null_count == 3
    assert labels is not None
    assert labels["object_id"].to_pylist() == [-1, 7]
    assert labels["class_name"].to_pylist() == ["dont_care", "car"]
    assert labels["x"].to_pylist() == [None, 20.0]
    calibration = dataset.calibration("0000")
    assert calibration is not None
    assert set(calibration) == {
        "image_from_sensor",
        "image_width_px",
        "image_height_px",
        "frame_id",
    }
    assert calibration["frame_id"] == detections["frame_id"][0].as_py()
    [row] = dataset.catalog().to_pylist()
    assert (row["frames"], row["detections"], row["labels"]) == (3, 3, 1)
    assert row["duration_s"] == pytest.approx(0.2)
    assert row["pose_origin"] == "logged"
    assert report.exit_status is ExitStatus.DONE


def test_units_travel_with_the_files(tmp_path: Path) -> None:
    ingest([write_sequence(tmp_path / "kitti")], tmp_path / "out")
    written = pq.read_schema(Dataset(tmp_path / "out").path("detections", "0000"))
    assert written.equals(schema.DETECTIONS)
    for name in schema.DETECTIONS.names:
        assert written.field(name).metadata == schema.DETECTIONS.field(name).metadata
    assert written.field("x").metadata[b"unit"] == b"m"


def test_sequence_without_any_detection_has_empty_tables_and_all_poses(tmp_path: Path) -> None:
    ingest([write_sequence(tmp_path / "kitti", detections=[])], tmp_path / "out")
    dataset = Dataset.open(tmp_path / "out")
    assert dataset.detections("0000").num_rows == 0
    assert dataset.poses("0000").num_rows == 3


def test_frames_in_several_batches_are_numbered_through(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hbbatch.sources.detection_store.BATCH_ROWS", 2)
    source = write_drive(tmp_path / "drive.mcap", 9)
    ingest([source], tmp_path / "small")
    monkeypatch.undo()
    ingest([source], tmp_path / "large")
    small, large = Dataset.open(tmp_path / "small"), Dataset.open(tmp_path / "large")
    assert small.detections("drive").equals(large.detections("drive"))
    assert small.poses("drive").equals(large.poses("drive"))
    assert small.poses("drive")["frame_index"].to_pylist() == list(range(9))
    assert small.catalog()["content_hash"] == large.catalog()["content_hash"]


def test_unknown_classes_are_listed(tmp_path: Path) -> None:
    line = f"0 {CAR.replace('Car', 'Forklift')} 0.5"
    report = ingest([write_sequence(tmp_path / "kitti", detections=[line])], tmp_path / "out")
    [outcome] = report.outcomes
    assert outcome.problems == ["classes that are not known, recorded as unknown: 'Forklift' (1)"]
    assert Dataset.open(tmp_path / "out").detections("0000")["class_name"][0].as_py() == "unknown"


def test_folder_of_logs(tmp_path: Path) -> None:
    (tmp_path / "drives").mkdir()
    write_drive(tmp_path / "drives" / "monday am.mcap")
    write_drive(tmp_path / "drives" / "tuesday.mcap")
    report = ingest([tmp_path / "drives"], tmp_path / "out")
    assert statuses(report) == {"monday-am": "ingested", "tuesday": "ingested"}


# --- again --------------------------------------------------------------------------------------


def test_again_is_a_no_op(tmp_path: Path) -> None:
    source = write_sequence(tmp_path / "kitti", labels=LABELS)
    ingest([source], tmp_path / "out")
    before = files(tmp_path / "out")
    report = ingest([source], tmp_path / "out")
    assert statuses(report) == {"0000": "unchanged"}
    assert report.outcomes[0].row is not None
    assert files(tmp_path / "out") == before


def test_force_reads_again_and_gives_the_same(tmp_path: Path) -> None:
    source = write_sequence(tmp_path / "kitti", labels=LABELS)
    ingest([source], tmp_path / "out")
    before = files(tmp_path / "out")
    assert statuses(ingest([source], tmp_path / "out", force=True)) == {"0000": "replaced"}
    assert files(tmp_path / "out") == before


def test_changed_source_is_replaced_and_nothing_else(tmp_path: Path) -> None:
    source = write_sequence(write_sequence(tmp_path / "kitti", labels=LABELS), "0001")
    ingest([source], tmp_path / "out")
    dataset = Dataset.open(tmp_path / "out")
    hashes = dict(zip(dataset.sequence_ids(), dataset.catalog()["content_hash"], strict=True))
    (source / "label_02" / "0000.txt").unlink()
    (source / "det_02" / "0000.txt").write_text(f"1 {CAR} 0.5\n")
    assert statuses(ingest([source], tmp_path / "out")) == {"0000": "replaced", "0001": "unchanged"}
    assert dataset.detections("0000")["score"].to_pylist() == [0.5]
    assert dataset.labels("0000") is None
    changed = dict(zip(dataset.sequence_ids(), dataset.catalog()["content_hash"], strict=True))
    assert changed["0000"] != hashes["0000"]
    assert changed["0001"] == hashes["0001"]


def test_other_detections_of_the_same_source_replace_it(tmp_path: Path) -> None:
    source = write_sequence(tmp_path / "kitti")
    (tmp_path / "better").mkdir()
    (tmp_path / "better" / "0000.txt").write_text(f"1 {CAR} 0.5\n")
    ingest([source], tmp_path / "out")
    report = ingest([source], tmp_path / "out", options=SourceOptions(tmp_path / "better"))
    assert statuses(report) == {"0000": "replaced"}


def test_what_an_earlier_version_ingested_is_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, out = write_drive(tmp_path / "drive.mcap"), tmp_path / "out"
    monkeypatch.setattr(ingest_task, "INGEST_VERSION", ingest_task.INGEST_VERSION - 1)
    before = ingest([source], out)
    monkeypatch.undo()
    assert [
        statuses(report) for report in (before, ingest([source], out), ingest([source], out))
    ] == [
        {"drive": "ingested"},
        {"drive": "replaced"},
        {"drive": "unchanged"},
    ]


def test_change_of_labels_alone_leaves_what_tracking_reads(tmp_path: Path) -> None:
    source = write_sequence(tmp_path / "kitti")
    first = ingest([source], tmp_path / "out").outcomes[0].row
    (source / "label_02").mkdir()
    (source / "label_02" / "0000.txt").write_text(LABELS)
    second = ingest([source], tmp_path / "out").outcomes[0].row
    assert first is not None
    assert second is not None
    assert first["content_hash"] == second["content_hash"]
    assert first["source_hash"] != second["source_hash"]


# --- names that collide -------------------------------------------------------------------------


def test_two_sources_with_the_same_sequence(tmp_path: Path) -> None:
    one = write_sequence(tmp_path / "training")
    two = write_sequence(tmp_path / "testing", frames=5)
    report = ingest([one, two], tmp_path / "out")
    assert [outcome.status.value for outcome in report.outcomes] == ["ingested", "failed"]
    assert "sequence 0000 is also in" in report.errors[0]
    assert Dataset.open(tmp_path / "out").poses("0000").num_rows == 3


def test_sequence_of_another_source_is_replaced_only_by_force(tmp_path: Path) -> None:
    one = write_sequence(tmp_path / "training")
    two = write_sequence(tmp_path / "testing", frames=5)
    ingest([one], tmp_path / "out")
    report = ingest([two], tmp_path / "out")
    assert statuses(report) == {"0000": "failed"}
    assert str(one) in report.errors[0]
    assert "--force" in report.errors[0]
    assert statuses(ingest([two], tmp_path / "out", force=True)) == {"0000": "replaced"}


def test_source_that_moved_is_known_by_its_content(tmp_path: Path) -> None:
    source = write_sequence(tmp_path / "here")
    ingest([source], tmp_path / "out")
    shutil.move(source, tmp_path / "there")
    assert statuses(ingest([tmp_path / "there"], tmp_path / "out")) == {"0000": "unchanged"}


def test_name_that_is_no_file_name_is_refused(tmp_path: Path) -> None:
    report = ingest([write_sequence(tmp_path / "kitti", "a b")], tmp_path / "out")
    assert statuses(report) == {"a b": "failed"}
    assert "sequence 'a b' cannot be a file name" in report.errors[0]


# --- failures -----------------------------------------------------------------------------------


def test_one_bad_sequence_does_not_stop_the_others(tmp_path: Path) -> None:
    source = tmp_path / "kitti"
    for name in ("0000", "0001", "0002"):
        write_sequence(source, name)
    write_sequence(source, "0001", calibration=calibration_text(P2=""))
    report = ingest([source], tmp_path / "out")
    assert statuses(report) == {"0000": "ingested", "0001": "failed", "0002": "ingested"}
    assert report.errors == [
        f"{source}/calib/0001.txt: P2 is missing. Restore the file from its origin."
    ]
    assert report.exit_status is ExitStatus.FAILED
    assert Dataset.open(tmp_path / "out").sequence_ids() == ["0000", "0002"]
    assert not [name for name in files(tmp_path / "out") if "0001" in name or "partial" in name]


def test_failed_sequence_keeps_its_former_tables(tmp_path: Path) -> None:
    source = write_sequence(tmp_path / "kitti")
    ingest([source], tmp_path / "out")
    before = files(tmp_path / "out")
    write_sequence(source, detections=["0 Car"])
    report = ingest([source], tmp_path / "out")
    assert statuses(report) == {"0000": "failed"}
    assert "keeps what it had" in report.errors[0]
    assert files(tmp_path / "out") == before


def test_failure_in_the_middle_of_a_sequence_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Batches have been written when the reader fails."""

    def breaking(batches: Iterator[FrameBatch], _: Path) -> Iterator[FrameBatch]:
        yield next(batches)
        raise SourceError("the disk died")

    monkeypatch.setattr("hbbatch.runner.ingest_tables._guarded", breaking)
    report = ingest([write_sequence(tmp_path / "kitti")], tmp_path / "out")
    assert statuses(report) == {"0000": "failed"}
    assert list(files(tmp_path / "out")) == ["catalog.parquet"]


def test_a_sequence_named_like_a_part_of_another_is_none(tmp_path: Path) -> None:
    """Only the other has changed, and workers end in any order."""
    source = write_sequence(write_sequence(tmp_path / "kitti"), "0000-001")
    ingest([source], tmp_path / "out", workers=2)
    write_sequence(source, frames=5)
    report = ingest([source], tmp_path / "out", workers=2)
    assert statuses(report) == {"0000": "replaced", "0000-001": "unchanged"}
    dataset = Dataset.open(tmp_path / "out")
    assert dataset.sequence_ids() == ["0000", "0000-001"]
    assert dataset.poses("0000-001").num_rows == 3


def test_stopped_before_the_catalogue_knew_is_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The source changes, its ingest is stopped late, and the source goes back to what it was."""
    source = write_sequence(tmp_path / "kitti", labels=LABELS)
    ingest([source], tmp_path / "out")
    before = files(tmp_path / "out")
    write_sequence(source, labels=LABELS.replace(" 7 ", " 8 "))

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hbbatch.runner.ingest.put_rows", stopped)
    with pytest.raises(KeyboardInterrupt):
        ingest([source], tmp_path / "out")
    monkeypatch.undo()
    assert files(tmp_path / "out") != before
    write_sequence(source, labels=LABELS)
    assert statuses(ingest([source], tmp_path / "out")) == {"0000": "replaced"}
    assert files(tmp_path / "out") == before


@pytest.mark.parametrize("table", ["labels", "calibration"])
def test_a_table_that_cannot_be_written_leaves_the_others(tmp_path: Path, table: str) -> None:
    source = write_sequence(tmp_path / "kitti", labels=LABELS)
    ingest([source], tmp_path / "out")
    shutil.rmtree(tmp_path / "out" / table)
    (tmp_path / "out" / table).touch()
    before = files(tmp_path / "out")
    write_sequence(source, labels=LABELS, frames=5)
    with pytest.raises(DatasetError, match=rf"out/{table}/.*: cannot be written"):
        ingest([source], tmp_path / "out")
    assert files(tmp_path / "out") == before


def test_source_that_cannot_be_read_does_not_stop_the_others(tmp_path: Path) -> None:
    report = ingest([tmp_path / "nowhere", write_sequence(tmp_path / "kitti")], tmp_path / "out")
    assert statuses(report) == {"0000": "ingested"}
    assert report.errors == [f"{tmp_path}/nowhere: does not exist. Check the path."]
    assert report.exit_status is ExitStatus.USAGE


def test_nothing_to_ingest_makes_no_dataset(tmp_path: Path) -> None:
    ingest([tmp_path / "nowhere"], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_damaged_log_is_partial_then_and_later(tmp_path: Path) -> None:
    source = write_drive(tmp_path / "drive.mcap", damage=True)
    for status in ("ingested", "unchanged"):
        report = ingest([source], tmp_path / "out")
        assert statuses(report) == {"drive": status}
        assert report.exit_status is ExitStatus.DATA_LOSS
    assert Dataset.open(tmp_path / "out").catalog()["partial"].to_pylist() == [True]


def test_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(DatasetError, match=r"file/out/catalog\.parquet: cannot be written"):
        ingest([write_sequence(tmp_path / "kitti")], tmp_path / "file" / "out")


def test_dataset_of_a_newer_version_is_left_alone(tmp_path: Path) -> None:
    source = write_sequence(tmp_path / "kitti")
    ingest([source], tmp_path / "out")
    path = tmp_path / "out" / "catalog.parquet"
    newer = {b"hbbatch_format_version": str(schema.FORMAT_VERSION + 1).encode()}
    pq.write_table(pq.read_table(path).replace_schema_metadata(newer), path)
    before = files(tmp_path / "out")
    with pytest.raises(DatasetError, match="newer hbbatch"):
        ingest([source], tmp_path / "out", force=True)
    assert files(tmp_path / "out") == before


# --- recordings that pause, and many of them -----------------------------------------------------


def write_paused(path: Path, seconds: tuple[int, ...]) -> Path:
    log = logs.LogWriter()
    for second in seconds:
        item = logs.detection((10.0, 2.0, 0.5, 4.0, 2.0, 1.5, 0.3), [("car", 0.9)])
        log.add("/d", second, logs.detections(second * SECOND, "map", [item]))
    return log.write(path)


def test_parts_of_a_recording_come_and_go_with_it(tmp_path: Path) -> None:
    source = write_paused(tmp_path / "drive.mcap", (1, 2, 3, 100, 101))
    two = {"drive-000": "ingested", "drive-001": "ingested"}
    assert statuses(ingest([source], tmp_path / "out")) == two
    again = ingest([source], tmp_path / "out")
    assert statuses(again) == dict.fromkeys(two, "unchanged")
    write_paused(source, (1, 2, 3))
    assert statuses(ingest([source], tmp_path / "out")) == {"drive": "ingested"}
    dataset = Dataset.open(tmp_path / "out")
    assert dataset.sequence_ids() == ["drive"]
    assert not dataset.path("poses", "drive-001").exists()


def test_several_processes_write_what_one_does(tmp_path: Path) -> None:
    (tmp_path / "drives").mkdir()
    for name in "abc":
        write_drive(tmp_path / "drives" / f"{name}.mcap", 5)
    ingest([tmp_path / "drives"], tmp_path / "one")
    report = ingest([tmp_path / "drives"], tmp_path / "many", workers=2)
    assert statuses(report) == dict.fromkeys("abc", "ingested")
    assert files(tmp_path / "one") == files(tmp_path / "many")


@pytest.mark.parametrize("table", ["detections", "poses", "labels"])
def test_tables_that_are_gone_are_made_again(tmp_path: Path, table: str) -> None:
    source = write_sequence(tmp_path / "kitti", labels=LABELS)
    ingest([source], tmp_path / "out")
    before = files(tmp_path / "out")
    Dataset.open(tmp_path / "out").path(table, "0000").unlink()
    assert statuses(ingest([source], tmp_path / "out")) == {"0000": "replaced"}
    assert files(tmp_path / "out").keys() == before.keys()
