"""Parabolas through the neighbours in time of each row."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hbbatch.packed import kernels as built
from hbbatch.tracking.local_fit import by_numpy, local_fit

REACH_S = 1.5


def rows(seed: int, count: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Owners, unevenly spaced times, two columns, weights."""
    rng = np.random.default_rng(seed)
    owner = np.sort(rng.integers(1, 4, count))
    time_s = np.cumsum(rng.uniform(0.0, 0.4, count))
    return owner, time_s, rng.normal(0, 50, (count, 2)), rng.uniform(0.1, 1, count)


@given(st.integers(0, 10**6), st.tuples(*[st.floats(-20, 20)] * 3))
def test_parabolas_are_kept(seed: int, factors: tuple[float, float, float]) -> None:
    owner, time_s, _, weights = rows(seed)
    level, slope, bend = factors
    values = (5e6 + level + slope * time_s + bend * time_s**2)[:, None]
    fitted = local_fit(np.ones_like(owner), time_s, values, weights, REACH_S)
    assert fitted == pytest.approx(values, abs=1e-3, rel=0)


def test_a_row_is_what_weighted_least_squares_says_of_its_neighbours() -> None:
    owner, time_s, values, weights = rows(0)
    fitted = local_fit(owner, time_s, values, weights, REACH_S)
    for row in range(len(owner)):
        apart = (time_s - time_s[row]) / REACH_S
        near = (owner == owner[row]) & (np.abs(apart) < 1)
        weight = np.sqrt(weights[near]) * (1 - apart[near] ** 2)
        for column in range(2):
            if near.sum() > 4:
                parabola = np.polyfit(apart[near], values[near, column], 2, w=weight)
                assert fitted[row, column] == pytest.approx(parabola[-1], abs=1e-3)


def test_too_few_neighbours_change_nothing() -> None:
    time_s = np.array([0.0, 0.1, 0.2, 9.0, 0.0, 5.0])
    owner = np.array([1, 1, 1, 1, 2, 3])
    values = np.array([[1.0], [3.0], [2.0], [7.0], [5.0], [6.0]])
    fitted = local_fit(owner, time_s, values, np.ones(6), REACH_S)
    assert fitted == pytest.approx(values, abs=0.01)


@pytest.mark.parametrize("compiled", [True, False])
def test_nothing_stays_nothing(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(built, "AVAILABLE", built.AVAILABLE and compiled)
    none = np.empty(0)
    assert local_fit(none.astype(int), none, np.empty((0, 3)), none, 1.0).shape == (0, 3)


@pytest.mark.parametrize("columns", [1, 2, 3, 5, 8])
def test_the_kernel_says_what_numpy_says(kernels: ModuleType, columns: int) -> None:
    for seed in range(5):
        owner, time_s, _, weights = rows(seed)
        values = np.random.default_rng(seed).normal(0, 50, (len(owner), columns))
        fitted = np.empty_like(values)
        kernels.local_fit(owner, time_s, values, weights, fitted, REACH_S)
        expected = by_numpy(owner, time_s, values, weights, REACH_S)
        assert fitted == pytest.approx(expected, abs=1e-6, rel=1e-9)


def fitting() -> list[Any]:
    """Arguments of the kernel that fit together."""
    values = np.ones((4, 3))
    return [np.ones(4, np.int64), np.arange(4.0), values, np.ones(4), values.copy(), 1.0]


@pytest.mark.parametrize(
    ("place", "wrong"),
    [
        *((place, np.ones(5)) for place in (1, 3)),
        (0, np.ones(5, np.int64)),
        *((place, np.ones(shape)) for place in (2, 4) for shape in ((5, 3), (4, 2), (4, 9))),
        *((5, reach_s) for reach_s in (0.0, -1.0, np.nan)),
    ],
)
def test_the_kernel_refuses_what_does_not_agree(
    kernels: ModuleType, place: int, wrong: object
) -> None:
    given = fitting()
    kernels.local_fit(*given)
    given[place] = wrong
    with pytest.raises(ValueError, match="do not agree"):
        kernels.local_fit(*given)


@pytest.mark.parametrize("wrong", [None, "text", np.ones(4, np.float32), np.ones((4, 3, 1))])
@pytest.mark.parametrize("place", range(6))
def test_the_kernel_refuses_other_types(kernels: ModuleType, place: int, wrong: object) -> None:
    given = fitting()
    given[place] = wrong
    with pytest.raises((ValueError, TypeError, BufferError)):
        kernels.local_fit(*given)
