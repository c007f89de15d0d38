"""Covariances of independent axes, each a chain of derivatives, in closed form.

An axis has `order` states: position, velocity (and acceleration). Its symmetric covariance is kept
as blocks `P[i][j]`, i ≤ j. White noise drives the highest derivative (Bar-Shalom, Li and
Kirubarajan 2001, section 6.2), so one code serves constant velocity and constant acceleration.
Blocks are tensors `(n, axes)` with times `(n, 1)`; `packed.covariance` has them in place in numpy.
"""

from __future__ import annotations

import math
from functools import cache

from hbbatch.motion.turns import Array


def pairs(order: int) -> list[tuple[int, int]]:
    """Indices of the upper triangle, in the order of the flat matrix."""
    return [(i, j) for i in range(order) for j in range(i, order)]


def propagate(
    covariance: dict[tuple[int, int], Array], noise: Array, dt_s: Array
) -> dict[tuple[int, int], Array]:
    """Covariance after a time step, F P Fᵀ + Q.

    Args:
        covariance: blocks at the start of the step.
        noise: spectral density of the highest derivative's noise, of the shape of a block.
        dt_s: length of the step in seconds.
    """
    order = max(j for _, j in covariance) + 1
    powers = [dt_s]
    while len(powers) < 2 * order - 1:
        powers.append(powers[-1] * dt_s)
    predicted = {}
    for i, j in pairs(order):
        total = noise * (powers[2 * order - 2 - i - j] / noise_divisor(order, i, j))
        for (a, b), weight in ancestors(order, i, j).items():
            block, lag = covariance[a, b], a + b - i - j
            total = total + (block * (weight * powers[lag - 1]) if lag else block)
        predicted[i, j] = total
    return predicted


@cache
def ancestors(order: int, i: int, j: int) -> dict[tuple[int, int], float]:
    """Which blocks (a, b) a step mixes into block (i, j): the factors of dt^(a + b - i - j)."""
    weights: dict[tuple[int, int], float] = {}
    for a in range(i, order):
        for b in range(j, order):
            pair = min(a, b), max(a, b)
            weight = 1.0 / (math.factorial(a - i) * math.factorial(b - j))
            weights[pair] = weights.get(pair, 0.0) + weight
    return weights


def noise_divisor(order: int, i: int, j: int) -> int:
    """What dt^(2·order - 1 - i - j) is divided by in the noise of block (i, j)."""
    return math.factorial(order - 1 - i) * math.factorial(order - 1 - j) * (2 * order - 1 - i - j)


def correct(
    covariance: dict[tuple[int, int], Array], measurement_variance: Array
) -> tuple[list[Array], dict[tuple[int, int], Array]]:
    """Kalman gain of each derivative for a measured position, and the posterior covariance.

    Args:
        covariance: prior blocks.
        measurement_variance: of the shape of a block.

    Returns:
        Gains, one of that shape a derivative, and the posterior blocks.
    """
    order = max(j for _, j in covariance) + 1
    inverse = 1.0 / (covariance[0, 0] + measurement_variance)
    gains = [covariance[0, i] * inverse for i in range(order)]
    posterior = {(i, j): covariance[i, j] - gains[i] * covariance[0, j] for i, j in pairs(order)}
    return gains, posterior
