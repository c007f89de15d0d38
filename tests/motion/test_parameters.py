"""The parameters a filter's options ask for are those its torch module has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from torch import nn

from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter
from hbbatch.motion.parameters import HybridOptions, KalmanOptions, misfit

KINDS = ("vehicle", "pedestrian", "cyclist")


@pytest.mark.parametrize(
    ("make", "options", "chosen"),
    [
        (KalmanFilter, KalmanOptions, {}),
        (KalmanFilter, KalmanOptions, {"model": "ca"}),
        (HybridFilter, HybridOptions, {}),
        (HybridFilter, HybridOptions, {"motion_model": "ca", "history": 2, "memory": 5}),
        (HybridFilter, HybridOptions, {"hidden": 7, "head": 3}),
    ],
)
def test_shapes_are_those_of_the_module(
    make: type[nn.Module], options: Any, chosen: dict[str, Any]
) -> None:
    state = make(KINDS, **chosen).state_dict()
    shapes = options(**chosen).shapes(len(KINDS))
    assert shapes == {name: tuple(value.shape) for name, value in state.items()}


@pytest.mark.parametrize(
    ("given", "wrong"),
    [
        ({"a": (2,)}, None),
        ({}, "a is missing"),
        ({"a": (2,), "b": (1,)}, "b is unknown"),
        ({"a": (3,)}, "a has shape (3,), not (2,)"),
    ],
)
def test_a_misfit_is_named(given: dict[str, tuple[int, ...]], wrong: str | None) -> None:
    parameters = {name: np.zeros(shape, np.float32) for name, shape in given.items()}
    assert misfit(parameters, {"a": (2,)}) == wrong
