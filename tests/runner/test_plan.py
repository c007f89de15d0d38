"""What is to do, and who does it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hbbatch.config import TrackSettings
from hbbatch.dataset import Dataset, Run
from hbbatch.dataset.store import write_json
from hbbatch.errors import UsageError
from hbbatch.runner import plan
from hbbatch.runner.plan import make_plan, select, sequence_key
from tests.runner.small_dataset import catalog_row, write_catalog

SETTINGS = TrackSettings()


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    dataset = Dataset.create(tmp_path)
    write_catalog(dataset, *(catalog_row(i) for i in ("0000", "0001", "0012")))
    return dataset


def finish(run: Run, row: dict[str, Any], settings: TrackSettings = SETTINGS) -> None:
    for output in (run.tracks(row["sequence_id"]), run.kitti(row["sequence_id"])):
        output.parent.mkdir(parents=True, exist_ok=True)
        output.touch()
    key = sequence_key(row["content_hash"], settings, "w")
    write_json(run.status(row["sequence_id"]), {"state": "done", "key": key})


def test_all_sequences_are_selected_where_none_is_named(dataset: Dataset) -> None:
    assert [r["sequence_id"] for r in select(dataset.catalog(), [])] == ["0000", "0001", "0012"]


def test_named_sequences_are_selected_once_and_in_order(dataset: Dataset) -> None:
    rows = select(dataset.catalog(), ["0012", "0000", "0012"])
    assert [row["sequence_id"] for row in rows] == ["0000", "0012"]


def test_an_unknown_sequence_is_refused_with_a_suggestion(dataset: Dataset) -> None:
    with pytest.raises(UsageError, match=r"no such sequence in the dataset: '012'.*0012"):
        select(dataset.catalog(), ["0000", "012"])


def test_an_unknown_sequence_like_no_other_is_told_what_there_is(dataset: Dataset) -> None:
    with pytest.raises(UsageError, match="It holds 3, from 0000 to 0012"):
        select(dataset.catalog(), ["monday"])


def test_an_empty_dataset_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="hbbatch ingest"):
        select(Dataset.create(tmp_path).catalog(), [])


def test_a_finished_sequence_is_up_to_date_and_the_rest_is_to_do(dataset: Dataset) -> None:
    rows, run = select(dataset.catalog(), []), dataset.run("r")
    finish(run, rows[1])
    made = make_plan(rows, run, SETTINGS, "w")
    assert made.up_to_date == ("0001",)
    assert [job.sequence_id for job in made.to_do] == ["0000", "0012"]
    assert made.outdated == ()


def test_other_settings_make_a_finished_sequence_outdated(dataset: Dataset) -> None:
    rows, run = select(dataset.catalog(), ["0001"]), dataset.run("r")
    finish(run, rows[0])
    made = make_plan(rows, run, TrackSettings(min_score=1.0), "w")
    assert made.outdated == ("0001",)
    assert made.to_do[0].key == sequence_key("content of 0001", TrackSettings(min_score=1.0), "w")


@pytest.mark.parametrize("lost", ["tracks", "kitti"])
def test_a_sequence_whose_output_is_gone_is_to_do(dataset: Dataset, lost: str) -> None:
    rows, run = select(dataset.catalog(), ["0001"]), dataset.run("r")
    finish(run, rows[0])
    getattr(run, lost)("0001").unlink()
    assert make_plan(rows, run, SETTINGS, "w").up_to_date == ()


@pytest.mark.parametrize("content", ["", "{", "[]", '{"state": "failed"}'])
def test_a_status_that_does_not_say_done_counts_for_nothing(dataset: Dataset, content: str) -> None:
    rows, run = select(dataset.catalog(), ["0001"]), dataset.run("r")
    finish(run, rows[0])
    run.status("0001").write_text(content)
    assert make_plan(rows, run, SETTINGS, "w").up_to_date == ()


def test_the_key_changes_with_everything_that_decides_results(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    keys = [
        sequence_key("content", SETTINGS, "weights"),
        sequence_key("other content", SETTINGS, "weights"),
        sequence_key("content", TrackSettings(filter="kalman"), "weights"),
        sequence_key("content", SETTINGS, "other weights"),
    ]
    assert keys[0] == sequence_key("content", SETTINGS, "weights")
    monkeypatch.setattr(plan, "code_version", lambda: "other code")
    keys.append(sequence_key("content", SETTINGS, "weights"))
    assert len(set(keys)) == 5


def test_the_code_version_names_the_package_version_and_a_hash() -> None:
    version, _, digest = plan.code_version().partition("+")
    assert version == plan.hbbatch.__version__
    assert len(digest) == 12


def test_the_code_version_covers_the_compiled_part() -> None:
    root = Path(plan.hbbatch.__file__).parent
    covered = {path for pattern in plan._DECIDES_RESULTS for path in root.glob(pattern)}
    sources = set((root / "packed/c").iterdir())
    assert sources
    assert sources <= covered
