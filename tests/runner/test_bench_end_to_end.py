"""What is measured from the shell's point of view; the figures are not judged here."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hbbatch.config import TrackSettings
from hbbatch.errors import HbbatchError
from hbbatch.runner.bench_end_to_end import end_to_end
from tests.runner.small_dataset import make_dataset

SETTINGS = TrackSettings(filter="kalman")


def test_each_number_of_sequences_is_run_in_every_way(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path / "small", "a", "b")
    table = end_to_end([dataset.root], [2, 3], SETTINGS, runs=1)
    ways = [("1", "1", "all"), ("1", "2", "2")]
    if hasattr(os, "sched_setaffinity"):
        ways = [("1", "1", "1"), *ways, ("2", "1", "1")]
    found = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    assert [(row["commands"], row["workers"], row["cores"]) for row in found] == ways * 2
    assert [row["sequences"] for row in found] == ["2"] * len(ways) + ["3"] * len(ways)
    frames = dataset.catalog()["frames"][0].as_py()
    assert {row["frames"] for row in found} == {f"{2 * frames}", f"{3 * frames}"}
    assert not (dataset.root / "runs").exists()


def test_nothing_is_run_where_no_dataset_is_named() -> None:
    assert end_to_end([], [50], SETTINGS, runs=1).rows == []


def test_a_command_that_fails_says_why(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path / "small", "a")
    with pytest.raises(HbbatchError, match="nosuch"):
        end_to_end([dataset.root], [1], TrackSettings(weights="nosuch"), runs=1)
