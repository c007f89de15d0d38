"""What the compiled recursions of `motion.covariance` need to know beforehand."""

from __future__ import annotations

import numpy as np

from hbbatch.motion import covariance as cov
from hbbatch.motion.constants import AXES
from hbbatch.packed.arrays import Single


class PackedCovariance:
    """Covariances of axes with `order` derivatives each.

    Blocks `(axes, n)` lie below each other in the order of `motion.covariance.pairs`.

    Attributes:
        mixed: blocks that a time step adds to others: target and source, to be taken in this
            order, for a block takes from later ones only.
    """

    def __init__(self, order: int) -> None:
        """Work out which blocks a time step mixes."""
        pairs = cov.pairs(order)
        number = {pair: place for place, pair in enumerate(pairs)}
        self._noise = [(2 * order - 1 - i - j, cov.noise_divisor(order, i, j)) for i, j in pairs]
        self._shares = [
            (number[i, j], number[a, b], a + b - i - j, factor)
            for i, j in pairs
            for (a, b), factor in cov.ancestors(order, i, j).items()
            if (a, b) != (i, j)
        ]
        self.mixed = [(target, source) for target, source, _, _ in self._shares]
        self._first = [number[i, i] for i in range(order)]

    def weights(self, dt_s: Single) -> Single:
        """Factors of time steps `(n,)`: a row for each of `mixed`, then for each block's noise."""
        rows = [factor * dt_s**power for _, _, power, factor in self._shares]
        rows += [dt_s**power / divisor for power, divisor in self._noise]
        return np.stack(rows)

    def start(self, covariance: Single, variances: Single) -> None:
        """Fill blocks of zeros with the variance `(axes, n)` of each higher derivative."""
        for place, variance in zip(self._first[1:], variances, strict=True):
            covariance[AXES * place : AXES * (place + 1)] = variance
