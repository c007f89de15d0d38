"""What the compiled kernels refuse: nothing is read or written beyond an array.

That they compute what their Python names say is tested with those: `tests/model/test_packed.py`,
`tests/tracking`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
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
from hbbatch.packed.kalman import DETECTION
from tests.model.twins import packed

ROWS, SEEN = 5, 8
REFUSALS = (ValueError, TypeError, OverflowError)


def _hybrid(*, learn_gain: bool = True) -> HybridFilter:
    """A filter whose gain network says something, or not."""
    module = HybridFilter(("a", "b"), "ca")
    nn.init.constant_(module.gain.read_out.weight, 0.1 if learn_gain else 0.0)
    nn.init.zeros_(module.gain.read_out.bias)
    return module


def calls(kernels: ModuleType) -> dict[str, tuple[Callable[..., object], list[Any]]]:
    """Each kernel with arguments that fit."""
    motion, silent = (packed(module.eval()) for module in (_hybrid(), _hybrid(learn_gain=False)))
    plain = packed(KalmanFilter(("a", "b"), "ct").eval())
    numbers, rows = np.arange(ROWS), np.array([4, 1])
    boxes, state = np.ones((7, 9)), np.ones((motion.height, 10), np.float32)
    plain_state = np.ones((plain.height, 9), np.float32)
    measured = np.ones((SEEN, 7))
    seen = np.ones((SEEN, DETECTION.width), np.float32)
    times, plain_times = (m.times(np.full(6, 0.1, np.float32)) for m in (motion, plain))
    kinds = np.zeros(SEEN, np.int64)
    known = [motion.layout, boxes, state]
    plain_known = [plain.layout, boxes, plain_state]
    return {
        "settle": (
            kernels.settle,
            [np.ones((6, 9), np.int64), rows, rows.copy(), numbers.copy(), ROWS, 3],
        ),
        "arrange": (kernels.arrange, [state, numbers]),
        "say": (
            kernels.say,
            [boxes, state, rows, rows, np.ones((SEEN, 7)), np.ones((SEEN, 3)), motion.velocity],
        ),
        "birth": (
            kernels.birth,
            [motion.layout, motion.newborn, kinds, measured, seen, rows, boxes, state, 7],
        ),
        "predict": (
            kernels.predict,
            [*known, times, numbers, np.ones(ROWS), np.ones((7, ROWS)), *motion._residual_layers],
        ),
        "predict without layers": (
            kernels.predict,
            [
                *[*plain_known, plain_times, numbers, np.empty(0), np.ones((7, ROWS))],
                *plain._residual_layers,
            ],
        ),
        "update": (
            kernels.update,
            [*known, measured, seen, numbers, *motion._gain_layers],
        ),
        "update with nothing said": (
            kernels.update,
            [*known, measured, seen, numbers, *silent._gain_layers],
        ),
        "update without layers": (
            kernels.update,
            [*plain_known, measured, seen, numbers, *plain._gain_layers],
        ),
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


NAMES = (
    "settle",
    "arrange",
    "say",
    "birth",
    "predict",
    "predict without layers",
    "update",
    "update with nothing said",
    "update without layers",
)


def test_all_are_listed(kernels: ModuleType) -> None:
    assert tuple(calls(kernels)) == NAMES
    assert {name.partition(" ")[0] for name in NAMES} | {"match", "lines", "local_fit"} == {
        name for name in vars(kernels) if not name.startswith("_")
    }


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


@pytest.mark.parametrize("name", NAMES)
def test_arguments_of_other_types_are_refused(kernels: ModuleType, name: str) -> None:
    kernel, right = calls(kernels)[name]
    kernel(*right)
    with pytest.raises(ValueError, match="number of arguments"):
        kernel(*right, 1)
    for place, value in enumerate(right):
        for wrong in unfit(value):
            with pytest.raises((*REFUSALS, BufferError)):
                kernel(*right[:place], wrong, *right[place + 1 :])


@pytest.mark.parametrize("name", NAMES)
def test_matrices_that_are_too_small_are_refused(kernels: ModuleType, name: str) -> None:
    kernel, right = calls(kernels)[name]
    for place, value in enumerate(right):
        if isinstance(value, int) or value.ndim != 2 or not value.size:
            continue
        if name == "arrange":  # a row is a row
            continue
        few = np.ascontiguousarray(value[:2])
        with pytest.raises(ValueError, match="do not agree"):
            kernel(*right[:place], few, *right[place + 1 :])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("beyond", [-1, 10, 2**62, -(2**63)])
def test_indices_beyond_are_refused(kernels: ModuleType, name: str, beyond: int) -> None:
    kernel, right = calls(kernels)[name]
    for place, value in enumerate(right):
        if isinstance(value, int) or value.dtype != np.int64 or value.ndim != 1:
            continue
        if (name, place) in {
            ("settle", 2),
            ("settle", 3),
        } or value.size > ROWS + SEEN:  # written to; layouts
            continue
        wrong = value.copy()
        wrong[-1 if len(wrong) < 9 else 3] = beyond
        if name == "birth" and place == 2:
            wrong[:] = beyond
        with pytest.raises(ValueError, match="do not agree"):
            kernel(*right[:place], wrong, *right[place + 1 :])


@pytest.mark.parametrize(("name", "place"), [("settle", 4), ("say", 6), ("birth", 8)])
@pytest.mark.parametrize("wrong", [-1, 2**62])
def test_numbers_beyond_are_refused(kernels: ModuleType, name: str, place: int, wrong: int) -> None:
    kernel, right = calls(kernels)[name]
    with pytest.raises(ValueError, match="do not agree"):
        kernel(*right[:place], wrong, *right[place + 1 :])


def test_a_row_matched_twice_is_refused(kernels: ModuleType) -> None:
    settle, (cells, _, *rest) = calls(kernels)["settle"]
    with pytest.raises(ValueError, match="matched twice"):
        settle(cells, np.array([1, 1]), *rest)


def test_any_layout_is_checked(kernels: ModuleType) -> None:
    """Layouts of random numbers are refused or lead nowhere beyond the state."""
    rng = np.random.default_rng(0)
    for name in ("birth", "predict", "update"):
        kernel, right = calls(kernels)[name]
        for _ in range(300):
            layout = right[0].copy()
            layout[rng.integers(0, len(layout), 3)] = rng.integers(-5, 250, 3)
            try:
                kernel(layout, *right[1:])
            except ValueError:
                continue
            assert layout[:2].max() < 250
