"""Rows come back as they were appended, wherever they wait."""

from __future__ import annotations

import numpy as np
import pytest

from hbbatch.sources.spool import Spool

COLUMNS, ROWS = 3, 40


@pytest.mark.parametrize("in_memory_bytes", [0, 300, 10**6], ids=["file", "both", "memory"])
@pytest.mark.parametrize("seed", range(5))
def test_any_runs_of_rows(in_memory_bytes: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    rows = random.normal(size=(COLUMNS, ROWS))
    spool = Spool(COLUMNS, in_memory_bytes)
    for block in np.split(rows, np.sort(random.integers(0, ROWS, 7)), axis=1):
        spool.append(block)
    starts = np.append(random.integers(0, ROWS, 20), [0, 7])
    counts = np.append(random.integers(0, ROWS - starts[:20] + 1), [7, ROWS - 7])
    expected = [rows[:, start : start + count] for start, count in zip(starts, counts, strict=True)]
    assert np.array_equal(spool.read(starts, counts), np.concatenate(expected, axis=1))


def test_nothing() -> None:
    none = np.zeros(0, dtype=np.int64)
    spool = Spool(COLUMNS)
    assert spool.read(none, none).shape == (COLUMNS, 0)
    spool.append(np.zeros((COLUMNS, 0)))
    assert spool.read(np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)).shape == (3, 0)
