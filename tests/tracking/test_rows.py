"""The table of tracks: who is matched, who lives on, who dies."""

from __future__ import annotations

import numpy as np

from hbbatch.tracking.association import Pairs
from hbbatch.tracking.rows import RowTable


def table_of(*first: int, patience: int) -> RowTable:
    table, born = RowTable(), np.array(first)
    table.append(born, born // 10, born % 10, patience)
    return table


def test_matched_rows_come_first_and_dying_ones_last() -> None:
    table = table_of(50, 61, 72, 83, patience=2)
    for _ in range(2):
        order, alive = table.settle(Pairs(np.array([2, 1]), np.array([7, 8])), max_misses=5)
    assert order.tolist() == [2, 1, 0, 3]
    assert alive == 2
    table.arrange(order)
    table.truncate(alive)
    assert table.first.tolist() == [72, 61]
    assert table.sequence.tolist() == [7, 6]
    assert table.block.tolist() == [2, 1]
    assert table.age.tolist() == [2, 2]
    assert table.misses.tolist() == [0, 0]


def test_a_match_gives_a_track_more_patience() -> None:
    table = table_of(0, 1, patience=1)
    order, alive = table.settle(Pairs(np.array([1]), np.array([5])), max_misses=3)
    table.arrange(order)
    table.truncate(alive)
    for survivors in (1, 1, 0):
        assert table.settle(Pairs.none(), max_misses=3)[1] == survivors
    assert table.misses.tolist() == [3]
