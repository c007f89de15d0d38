"""A worker's group: outputs, and what happens when one sequence is bad."""

from __future__ import annotations

import json
from pathlib import Path
from threading import Barrier, get_ident
from typing import Any

import pyarrow as pa
import pytest

from hbbatch import schema
from hbbatch.config import TrackSettings
from hbbatch.dataset import Dataset, Run
from hbbatch.dataset.store import table_into, write_json
from hbbatch.runner import worker
from hbbatch.runner.dealing import Group, SequenceJob
from hbbatch.runner.orders import Order, Outcome
from hbbatch.runner.worker import track_group
from tests.runner.small_dataset import load_echo, make_dataset, write_sequence

SETTINGS = TrackSettings()


def order(dataset: Dataset) -> Order:
    return Order(dataset, dataset.run("r"), SETTINGS, "cpu", load_echo, recipe="r")


def group(*sequence_ids: str) -> Group:
    return tuple(SequenceJob(i, "source", f"key of {i}", 3, 6) for i in sequence_ids)


def outcomes(dataset: Dataset, *sequence_ids: str) -> dict[str, Outcome]:
    loaded = load_echo(SETTINGS, "cpu")
    found = list(track_group(order(dataset), loaded, group(*sequence_ids), worker=4))
    assert len(found) == len(sequence_ids)
    return {outcome.sequence_id: outcome for outcome in found}


def test_a_sequence_is_written_as_tracks_kitti_text_and_status(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a")
    timing = outcomes(dataset, "a")["a"].timing
    run = dataset.run("r")
    tracks = run.read_tracks("a")
    assert tracks.schema.equals(schema.TRACKS)
    assert tracks["track_id"].to_pylist() == [1, 2, 1, 2, 1, 2]
    assert tracks["detection_id"].to_pylist() == [0, 1, 2, 3, 4, 5]
    lines = run.kitti("a").read_text().splitlines()
    assert [line.split()[:3] for line in lines[:2]] == [["0", "1", "Car"], ["0", "2", "Car"]]
    status = json.loads(run.status("a").read_text())
    assert status.pop("timing") == timing
    assert status == {"sequence_id": "a", "state": "done", "key": "key of a", "recipe": "r"}


def test_timing_says_who_did_how_much(tmp_path: Path) -> None:
    timing = outcomes(make_dataset(tmp_path, "a"), "a")["a"].timing
    assert timing is not None
    assert set(timing) == set(schema.TIMING.names)
    assert (timing["frames"], timing["detections"], timing["tracks"]) == (3, 6, 2)
    assert (timing["worker"], timing["device"]) == (4, "cpu")
    stages = ("read", "predict", "associate", "update", "manage", "write")
    assert timing["wall_s"] == pytest.approx(sum(timing[f"{stage}_s"] for stage in stages))
    assert timing["peak_rss_mb"] > 1


def test_a_sequence_without_detections_is_a_result_file_of_zero_bytes(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a")
    write_sequence(dataset, "a", frames=3, cars=0)
    outcomes(dataset, "a")
    assert dataset.run("r").kitti("a").read_bytes() == b""
    assert dataset.run("r").read_tracks("a").num_rows == 0


def test_without_calibration_boxes_are_written_without_image_boxes(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a")
    dataset.calibration_path("a").unlink()
    outcomes(dataset, "a")
    assert dataset.run("r").kitti("a").read_text().split()[6:10] == ["-1", "-1", "-1", "-1"]


def test_a_sequence_that_cannot_be_read_fails_alone(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b", "c")
    dataset.path("poses", "b").unlink()
    dataset.path("detections", "c").write_bytes(b"no parquet")
    found = outcomes(dataset, "a", "b", "c")
    assert found["a"].error is None
    assert "poses of sequence b" in str(found["b"].error)
    assert "detections of sequence c" in str(found["c"].error)
    assert not dataset.run("r").status("b").exists()


def test_tables_of_another_time_than_the_catalogue_fail_alone(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    table, path = dataset.detections("b"), dataset.path("detections", "b")
    with table_into(path, schema.DETECTIONS, path, source_hash="another") as write:
        write(table)
    found = outcomes(dataset, "a", "b")
    assert found["a"].error is None
    assert "not those that the catalogue speaks of" in str(found["b"].error)
    assert not dataset.run("r").status("b").exists()


def test_a_sequence_that_breaks_the_tracker_fails_alone(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "raises", "b")
    found = outcomes(dataset, "a", "raises", "b")
    assert found["a"].error is None
    assert found["b"].error is None
    assert found["raises"].error == (
        "ValueError: matrix is singular. This is a defect of hbbatch; "
        "`hbbatch --traceback ...` shows where."
    )


def test_a_sequence_the_tracker_gives_nothing_for_fails(tmp_path: Path) -> None:
    found = outcomes(make_dataset(tmp_path, "a", "forgotten"), "a", "forgotten")
    assert found["a"].error is None
    assert "gave no result" in str(found["forgotten"].error)


@pytest.mark.parametrize(
    "calibration",
    [{}, {"image_from_sensor": [1, 2], "image_width_px": 9, "image_height_px": 9}],
)
def test_an_unusable_calibration_is_named(tmp_path: Path, calibration: dict[str, object]) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    write_json(dataset.calibration_path("b"), calibration)
    found = outcomes(dataset, "a", "b")
    assert found["a"].error is None
    assert str(dataset.calibration_path("b")) in str(found["b"].error)
    assert "Ingest the sequence again" in str(found["b"].error)


def test_a_group_too_large_for_memory_is_taken_in_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hbbatch.runner.worker.MAX_PART_DETECTIONS", 12)
    dataset = make_dataset(tmp_path, "a", "b", "c", "raises", "e")
    dataset.path("poses", "c").unlink()
    found = outcomes(dataset, "a", "b", "c", "raises", "e")
    assert {i for i, outcome in found.items() if outcome.error is not None} == {"c", "raises"}
    assert dataset.run("r").read_tracks("e").num_rows == 6


def test_an_old_status_is_gone_before_outputs_change(tmp_path: Path) -> None:
    """Else a crash in between would leave new tracks that an old key vouches for."""
    dataset = make_dataset(tmp_path, "a")
    outcomes(dataset, "a")
    run = dataset.run("r")
    run.kitti("a").unlink()
    run.kitti("a").mkdir()
    assert outcomes(dataset, "a")["a"].error is not None
    assert not run.status("a").exists()


def test_a_sequence_is_written_while_another_one_waits_for_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    both = Barrier(2, timeout=30)
    remove = worker.remove_status

    def slow(run: Run, sequence_id: str) -> None:
        both.wait()
        remove(run, sequence_id)

    monkeypatch.setattr(worker, "remove_status", slow)
    found = outcomes(make_dataset(tmp_path, "a", "b"), "a", "b")
    assert [outcome.error for outcome in found.values()] == [None, None]


def test_one_thread_encodes_and_it_is_not_the_one_that_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More would only take turns with it at the interpreter."""
    threads = set()
    encode = worker.tracks_table

    def noted(*given: Any) -> pa.Table:
        threads.add(get_ident())
        return encode(*given)

    monkeypatch.setattr(worker, "tracks_table", noted)
    names = [f"s{number}" for number in range(12)]
    outcomes(make_dataset(tmp_path, *names), *names)
    assert len(threads) == 1
    assert get_ident() not in threads
