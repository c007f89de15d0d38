"""Angles."""

from __future__ import annotations

import math

import torch
from torch import Tensor

TWO_PI = 2.0 * math.pi


def wrap_angle(angle_rad: Tensor) -> Tensor:
    """Angles wrapped to [-π, π)."""
    return torch.remainder(angle_rad + math.pi, TWO_PI) - math.pi


def wrap_half_turn(angle_rad: Tensor) -> Tensor:
    """Angles wrapped to [-π/2, π/2): the turn between two axes whose direction does not matter."""
    return torch.remainder(angle_rad + math.pi / 2, math.pi) - math.pi / 2
