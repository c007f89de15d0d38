"""What the compiled kernels refuse: nothing is read or written beyond an array.

That they compute what their Python names say is tested with those: `tests/tracking`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from torch import nn

from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter
from hbbatch.motion import constants
from hbbatch.packed import kalman
from hbbatch.packed.arrays import KnownArrays, SaidArrays, StepArrays, TrackArrays
from hbbatch.packed.kalman import DETECTION, PackedKalman
from tests.packed.twins import packed

SEEN, STEPS, COLUMNS, PLACES = 8, 4, 16, 12
REFUSALS = (ValueError, TypeError, OverflowError)

FILTERS = ("hybrid", "silent", "kalman")
"""A filter whose gain network says something, or not, and one without networks."""


def _filter(name: str) -> PackedKalman:
    if name == "kalman":
        return packed(KalmanFilter(("a", "b"), "ct").eval())
    module = HybridFilter(("a", "b"), "ca")
    nn.init.constant_(module.gain.read_out.weight, 0.1 if name == "hybrid" else 0.0)
    nn.init.zeros_(module.gain.read_out.bias)
    return packed(module.eval())


def call(name: str) -> dict[str, Any]:
    """Arguments by name for four steps, in each of which both of two tracks are seen."""
    motion = _filter(name)
    rng = np.random.default_rng(0)
    measured = np.tile([[0, 0, 1, 4, 2, 1.5, 0.1], [50, 0, 1, 4, 2, 1.5, 0.1]], (STEPS, 1))
    measured += 0.1 * rng.normal(size=measured.shape)
    known = KnownArrays(
        offsets=np.arange(0, SEEN + 1, 2),
        first_frame=np.array([0, 1]),
        sequence=np.array([0, 1] * STEPS),
        place=np.array([0, 4, 1, 5, 2, 6, 3, 7]),
        block=np.array([0, 1] * STEPS),
        kinds=np.array([0, 1] * STEPS),
        measured=measured,
        seen=np.ones((SEEN, DETECTION.width), np.float32),
        times=motion.times(np.full(STEPS + 1, 0.1, np.float32)),
    )
    tracks = TrackArrays(
        np.zeros((6, COLUMNS), np.int64),
        np.zeros((7, COLUMNS)),
        np.zeros((motion.height, COLUMNS), np.float32),
    )
    said = SaidArrays(
        first=np.zeros(PLACES, np.int64),
        step=np.zeros(PLACES, np.int64),
        boxes=np.zeros((PLACES, 7)),
        velocity_m_s=np.zeros((PLACES, 3)),
    )
    step = StepArrays(
        priors=np.zeros(7 * COLUMNS),
        rows=np.zeros(COLUMNS, np.int64),
        numbers=np.zeros(COLUMNS, np.int64),
        counts=np.array([0, SEEN, 0, 0]),
        seconds=np.zeros(4),
    )
    numbers = {"start": 0, "stop": STEPS, "patience": 3, "patience_unconfirmed": 2}
    return {
        **known._asdict(),
        **motion.arrays()._asdict(),
        "damping": np.array([8.0, 0.1, 0.9, 3.0]),
        **{f"tracks {name}": matrix for name, matrix in tracks._asdict().items()},
        **{f"said {name}": column for name, column in said._asdict().items()},
        **step._asdict(),
        **numbers,
        "max_coasted": 2,
        "stretch": 2.0,
        "threshold": 1.2,
        "matching": None,
    }


def test_constants_are_those_of_the_modules() -> None:
    header = (Path(kalman.__file__).parent / "c" / "state.h").read_text()
    defined = dict(re.findall(r"^#define (\w+) ([\d.]+)f?$", header, re.MULTILINE))
    assert {name: float(value) for name, value in defined.items()} == {
        "SMALLEST_SIZE_M": constants.SMALLEST_SIZE_M,
        "MAX_HEADING_VOTE": constants.MAX_HEADING_VOTE,
        "LONGEST_TENTHS": 10.0 * constants.LONGEST_TIME_S,
        "LARGEST_SAID": constants.LARGEST_SAID,
    }


def test_all_are_tested(kernels: ModuleType) -> None:
    """Here, with association, texts and smoothing."""
    assert {name for name in vars(kernels) if not name.startswith("_")} == {
        *("steps", "match", "lines", "local_fit")
    }


@pytest.mark.parametrize("name", FILTERS)
def test_two_tracks_go_their_ways(kernels: ModuleType, name: str) -> None:
    given = call(name)
    assert kernels.steps(*given.values()) == STEPS
    assert given["counts"].tolist() == [2, SEEN, 6, 6]
    assert given["said first"][:SEEN].tolist() == [0] * STEPS + [4] * STEPS
    assert given["said boxes"][given["place"]] == pytest.approx(given["measured"], abs=0.5)
    assert (given["seconds"] > 0).all()


@pytest.mark.parametrize("name", FILTERS)
def test_columns_without_a_track_are_left_alone(kernels: ModuleType, name: str) -> None:
    given = call(name)
    for matrix in ("boxes", "state"):
        given[f"tracks {matrix}"][:] = np.nan
    kernels.steps(*given.values())
    for matrix in ("boxes", "state"):
        assert np.isfinite(given[f"tracks {matrix}"][:, :2]).all()
        assert np.isnan(given[f"tracks {matrix}"][:, 2:]).all()


def test_tracks_keep_their_columns_as_far_as_they_can(kernels: ModuleType) -> None:
    """The last one that is matched fills the gap of one that dies."""
    given = call("kalman")
    x = np.array([0.0, 30, 60, 90, 0, 60, 90, 0])  # the second of four is not seen again
    given["measured"][:] = [0, 0, 1, 4, 2, 1.5, 0.1]
    given["measured"][:, 0] = x
    given |= {
        "offsets": np.array([0, 4, 7]),
        "stop": 2,
        "patience_unconfirmed": 1,
        "max_coasted": 0,
        **{what: np.zeros(SEEN, np.int64) for what in ("sequence", "block", "kinds")},
        "place": np.arange(SEEN),
    }
    assert kernels.steps(*given.values()) == 2
    assert given["counts"].tolist() == [3, SEEN, 4, 3]
    assert given["tracks cells"][0, :3].tolist() == [0, 3, 2]


def test_steps_stop_where_there_is_no_room(kernels: ModuleType) -> None:
    given = call("kalman")
    for matrix in ("cells", "boxes", "state"):
        given[f"tracks {matrix}"] = np.ascontiguousarray(given[f"tracks {matrix}"][:, :3])
    given |= {
        "priors": np.empty(21),
        "rows": np.empty(3, np.int64),
        "numbers": np.empty(3, np.int64),
    }
    assert kernels.steps(*given.values()) == 1  # two tracks, and two that might be born
    assert given["counts"].tolist() == [2, SEEN, 0, 0]
    # Two tracks that coast, and places for four boxes of them.
    given = {**call("kalman"), "offsets": np.array([0, 2, 2, 2, 2]), "patience_unconfirmed": 5}
    assert kernels.steps(*given.values()) == 3
    assert given["said step"][SEEN:].tolist() == [1, 1, 2, 2]


def unfit(value: Any) -> Iterator[object]:
    """What an argument must not be, whatever it is for."""
    yield None
    yield "text"
    if isinstance(value, int):
        yield from (2**80, 1.5)
        return
    yield value.astype(np.int16)
    yield value[None]
    yield value.astype(">f8")
    if value.ndim == 2 and value.size:
        yield np.asfortranarray(value)
        yield value[:, ::2]


INTEGERS = ("start", "stop", "patience", "patience_unconfirmed", "max_coasted")


@pytest.mark.parametrize("name", FILTERS)
def test_arguments_of_other_types_are_refused(kernels: ModuleType, name: str) -> None:
    right = call(name)
    with pytest.raises(ValueError, match="number of arguments"):
        kernels.steps(*right.values(), 1)
    for what, value in right.items():
        if what == "matching" or isinstance(value, float):
            continue
        for wrong in unfit(value):
            with pytest.raises((*REFUSALS, BufferError)):
                kernels.steps(*{**right, what: wrong}.values())
    for what in ("stretch", "threshold", "matching"):
        with pytest.raises(TypeError):
            kernels.steps(*{**right, what: "text"}.values())
    odd = np.frombuffer(bytearray(8 * SEEN + 1), np.uint8)[1:].view(np.int64)
    with pytest.raises(ValueError, match="another type"):
        kernels.steps(*{**right, "sequence": odd}.values())


@pytest.mark.parametrize("name", FILTERS)
def test_arrays_that_are_too_small_are_refused(kernels: ModuleType, name: str) -> None:
    right = call(name)
    for what, value in right.items():
        if not isinstance(value, np.ndarray) or not value.size or what.endswith("_limit"):
            continue
        smaller = [value[:-1]] if value.ndim == 1 else [value[:-1], value[:, :-1]]
        for few in smaller:
            with pytest.raises(ValueError, match="do not agree"):
                kernels.steps(*{**right, what: np.ascontiguousarray(few)}.values())


@pytest.mark.parametrize(
    "what", ["offsets", "first_frame", "sequence", "place", "kinds", "counts", "start", "stop"]
)
@pytest.mark.parametrize("beyond", [-9, 20, 2**62, 2**63 - 1, -(2**63)])
def test_numbers_beyond_are_refused(kernels: ModuleType, what: str, beyond: int) -> None:
    right = call("hybrid")
    if isinstance(right[what], int):
        wrong: list[object] = [beyond]
    else:
        places = range(2 if what == "counts" else len(right[what]))
        wrong = [np.where(np.arange(len(right[what])) == i, beyond, right[what]) for i in places]
    for value in wrong:
        with pytest.raises(ValueError, match="do not agree"):
            kernels.steps(*{**right, what: value}.values())


@pytest.mark.parametrize("row", [1, 4, 5])
def test_tracks_that_there_cannot_be_are_refused(kernels: ModuleType, row: int) -> None:
    right = call("hybrid")
    kernels.steps(*right.values())
    right["tracks cells"][row, 1] = -1
    with pytest.raises(ValueError, match="do not agree"):
        kernels.steps(*{**right, "start": 3}.values())


@pytest.mark.parametrize(
    ("rows", "numbers", "count"),
    [
        ([0, 0], [2, 3], 2),
        ([0, 1], [2, 2], 2),
        ([0, 2], [2, 3], 2),
        ([-1, 0], [2, 3], 2),
        ([0, 1], [1, 2], 2),
        ([0, 1], [2, 4], 2),
        ([0, 1], [2, 3], 3),
        ([0, 1], [2, 3], -1),
        ([0, 1], [2, 3], 2**80),
        ([0, 1], [2, 3], "two"),
    ],
)
def test_pairs_that_there_are_not_are_refused(
    kernels: ModuleType, rows: list[int], numbers: list[int], count: object
) -> None:
    given = call("hybrid")

    def matching(tracks: int, start: int, stop: int) -> object:
        assert (tracks, start, stop) == (2, 2, 4)
        given["rows"][:2], given["numbers"][:2] = rows, numbers
        return count

    with pytest.raises(REFUSALS):
        kernels.steps(*{**given, "matching": matching}.values())


def test_what_fails_while_matching_is_raised(kernels: ModuleType) -> None:
    def matching(tracks: int, start: int, stop: int) -> int:
        raise KeyError("not today")

    with pytest.raises(KeyError, match="not today"):
        kernels.steps(*{**call("kalman"), "matching": matching}.values())


def surrounded(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A matrix within a larger one, and what is around it: as many numbers before and after."""
    size = matrix.size
    whole = np.full(3 * size, 77.0, matrix.dtype)
    whole[size : 2 * size] = matrix.ravel()
    return whole[size : 2 * size].reshape(matrix.shape), whole.reshape(3, size)[::2]


def test_any_layout_is_checked(kernels: ModuleType) -> None:
    """Layouts of random numbers are refused or lead nowhere beyond the state."""
    rng = np.random.default_rng(0)
    for name in FILTERS:
        for _ in range(300):
            given = call(name)
            layout = given["layout"].copy()
            layout[rng.integers(0, len(layout), 3)] = rng.integers(-5, 250, 3)
            given["tracks state"], around = surrounded(given["tracks state"])
            with suppress(ValueError):
                kernels.steps(*{**given, "layout": layout}.values())
            assert (around == 77.0).all()
