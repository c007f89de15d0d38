"""The timing table."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from hbbatch import schema
from hbbatch.runner.timing import STAGES, peak_rss_mb, stage_seconds, timing_table


def row(sequence_id: str, seconds: float) -> dict[str, object]:
    stages = {f"{stage}_s": seconds for stage in STAGES}
    counts = {"frames": 1, "detections": 1, "tracks": 1, "worker": 0}
    rates = {"wall_s": 1.0, "frames_per_s": 1.0, "peak_rss_mb": 1.0}
    return {"sequence_id": sequence_id, "device": "cpu", **counts, **rates, **stages}


def test_rows_become_a_table_sorted_by_sequence() -> None:
    table = timing_table([row("b", 1.0), row("a", 2.0)])
    assert table.schema.equals(schema.coded(schema.TIMING))
    assert table["sequence_id"].to_pylist() == ["a", "b"]


def test_no_rows_make_an_empty_table() -> None:
    assert timing_table([]).num_rows == 0


def test_stages_are_summed_over_sequences() -> None:
    assert stage_seconds([row("a", 1.5), row("b", 2.0)]) == dict.fromkeys(STAGES, 3.5)


def test_stages_are_the_seconds_of_the_schema() -> None:
    assert [f"{stage}_s" for stage in STAGES] == [
        name for name in schema.TIMING.names if name.endswith("_s") and name != "wall_s"
    ][: len(STAGES)]


def test_peak_memory_is_that_of_a_python_process() -> None:
    assert 5 < peak_rss_mb() < 1_000_000
    assert peak_rss_mb() == pytest.approx(peak_rss_mb(), rel=0.5)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the system tells it right")
def test_a_process_does_not_answer_for_the_memory_of_the_one_that_started_it() -> None:
    big = np.ones(60_000_000)
    code = "from hbbatch.runner.timing import peak_rss_mb; print(peak_rss_mb())"
    command = [sys.executable, "-c", code]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert 10 < float(said) < big.nbytes / 1e6 < peak_rss_mb()
