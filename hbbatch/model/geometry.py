"""Angles and turns."""

from __future__ import annotations

import math
from typing import Any, TypeVar

import torch
from numpy.typing import NDArray
from torch import Tensor

Array = TypeVar("Array", Tensor, NDArray[Any])
"""Plain arithmetic serves the filters' tensors as well as their packed twins' arrays."""

TWO_PI = 2.0 * math.pi


def wrap_angle(angle_rad: Tensor) -> Tensor:
    """Angles wrapped to [-π, π)."""
    return torch.remainder(angle_rad + math.pi, TWO_PI) - math.pi


def wrap_half_turn(angle_rad: Tensor) -> Tensor:
    """Angles wrapped to [-π/2, π/2): the turn between two axes whose direction does not matter."""
    return torch.remainder(angle_rad + math.pi / 2, math.pi) - math.pi / 2


def turn(x: Array, y: Array, cos: Array, sin: Array) -> tuple[Array, Array]:
    """The vectors (x, y) turned counter-clockwise by an angle given as cosine and sine."""
    return cos * x - sin * y, sin * x + cos * y
