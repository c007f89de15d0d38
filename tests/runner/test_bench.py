"""The benchmark runs through and writes where it is told to; its figures are not judged here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hbbatch.config import TrackSettings
from hbbatch.runner import bench as bench_module
from hbbatch.runner.bench import BenchRequest, bench, synthetic_crowd
from hbbatch.runner.bench_report import Table, as_markdown
from tests.runner.small_dataset import make_dataset


def test_every_table_is_measured_and_nothing_is_left_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench_module, "CROWDS", (3,))
    monkeypatch.setattr(bench_module, "BUSY_CROWD", 3)
    monkeypatch.setattr(bench_module, "STEPPING_S", 0.0)
    dataset = make_dataset(tmp_path / "small", "a", "b")
    request = BenchRequest(
        datasets=(dataset.root,),
        end_to_end=(dataset.root,),
        settings=TrackSettings(),
        runs=1,
        repeats=(1,),
        sequences=(3,),
    )
    told: list[str] = []
    tables = bench(request, told.append)
    assert len(tables) == len(told) == 9
    assert all(len(row) == len(table.columns) for table in tables for row in table.rows)
    by_title = {table.title: table for table in tables}
    machine = dict(by_title["This core"].rows)
    assert "(" in machine["numpy multiplies with"], "for which processors"
    (row, _) = next(t for title, t in by_title.items() if title.startswith("Stepping")).rows
    assert row[:3] == ("small", "6", "8")  # two tracks a sequence, predicted in two of three frames
    assert not list((dataset.root / "runs").iterdir())


def test_a_crowd_keeps_its_density() -> None:
    for tracks in (10, 1000):
        crowd = synthetic_crowd(tracks, frames=20, seed=0)
        assert len(crowd.boxes) == pytest.approx(0.95 * 20 * tracks, rel=0.1)
        first = crowd.boxes[: crowd.offsets[1]]
        area = np.prod(np.ptp(first[:, :2], axis=0))
        assert area / tracks == pytest.approx(100, rel=0.5)


def test_tables_are_sections_of_markdown() -> None:
    table = Table("This core", ("figure", "value"), [("rate", "1")], "A note.")
    assert as_markdown([table]).strip() == (
        "### This core\n\n| figure | value |\n| --- | ---: |\n| rate | 1 |\n\nA note."
    )
