"""Columns that come, go and change places."""

from __future__ import annotations

import numpy as np
import pytest

from hbbatch.packed import kernels
from hbbatch.packed.room import Room


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int64])
@pytest.mark.parametrize("compiled", [True, False])
def test_columns_come_go_and_change_places(
    dtype: type, compiled: bool, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    if compiled:
        request.getfixturevalue("kernels")
    monkeypatch.setattr(kernels, "AVAILABLE", compiled)
    rng = np.random.default_rng(0)
    room: Room[np.generic] = Room(3, dtype)
    expected = np.empty((3, 0), dtype)
    for step in range(30):
        born = rng.integers(-99, 99, (3, 7 * step)).astype(dtype)
        new = room.append(born.shape[1])
        room.whole[:, new] = born
        expected = np.concatenate([expected, born], axis=1)
        order = rng.permutation(room.count)[: 5 * room.count // 6]
        room.arrange(order)
        expected = expected[:, order]
        room.truncate(room.count - step)
        expected = expected[:, : room.count]
        assert np.array_equal(room.whole[:, : room.count], expected)
        assert np.array_equal(room.row(1), expected[1])
    assert room.whole.flags.c_contiguous
    assert (room.whole.shape[1] // 16) % 2
