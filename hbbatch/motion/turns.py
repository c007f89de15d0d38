"""Turning vectors, in plain arithmetic."""

from __future__ import annotations

from typing import Any, TypeVar

Array = TypeVar("Array", bound=Any)
"""Plain arithmetic serves the filters' tensors as well as their packed twins' numpy arrays."""


def turn(x: Array, y: Array, cos: Array, sin: Array) -> tuple[Array, Array]:
    """The vectors (x, y) turned counter-clockwise by an angle given as cosine and sine."""
    return cos * x - sin * y, sin * x + cos * y
