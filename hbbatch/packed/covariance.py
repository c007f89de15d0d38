"""The recursions of `motion.covariance` for few rows: in place, many blocks an operation."""

from __future__ import annotations

import numpy as np

from hbbatch.motion import covariance as cov
from hbbatch.motion.constants import AXES
from hbbatch.packed.arrays import Single


class PackedCovariance:
    """Covariances of axes with `order` derivatives each.

    Blocks `(axes, n)` lie below each other in the order of `motion.covariance.pairs`.
    """

    def __init__(self, order: int) -> None:
        """Work out which blocks a time step mixes."""
        pairs = cov.pairs(order)
        number = {pair: place for place, pair in enumerate(pairs)}
        self._order = order
        self._noise = [(2 * order - 1 - i - j, cov.noise_divisor(order, i, j)) for i, j in pairs]
        # A block takes from later ones only, so one after the other they can change in place.
        self._mixed = [
            (number[i, j], number[a, b], a + b - i - j, factor)
            for i, j in pairs
            for (a, b), factor in cov.ancestors(order, i, j).items()
            if (a, b) != (i, j)
        ]
        self._first = [number[i, i] for i in range(order)]
        self.height = AXES * len(pairs)
        self.weights_height = len(self._mixed) + len(pairs)

    def weights(self, dt_s: Single) -> Single:
        """Rows `(weights_height, n)` that `propagate` needs of time steps `(n,)`."""
        rows = [factor * dt_s**power for _, _, power, factor in self._mixed]
        rows += [dt_s**power / divisor for power, divisor in self._noise]
        return np.stack(rows)

    def start(self, covariance: Single, variances: Single) -> None:
        """Fill blocks of zeros with the variance `(axes, n)` of each higher derivative."""
        for place, variance in zip(self._first[1:], variances, strict=True):
            covariance[AXES * place : AXES * (place + 1)] = variance

    def propagate(self, covariance: Single, noise: Single, weights: Single) -> None:
        """A time step, F P Fᵀ + Q.

        Args:
            covariance: `(height, n)`, changed in place.
            noise: `(axes, n)` spectral density of the highest derivative's noise.
            weights: of the step.
        """
        blocks = covariance.reshape(len(self._noise), AXES, covariance.shape[1])
        for (target, source, _, _), weight in zip(self._mixed, weights, strict=False):
            blocks[target] += blocks[source] * weight
        blocks += noise * weights[len(self._mixed) :, None]

    def shrink(self, covariance: Single, position_gain: Single, inverse: Single) -> list[Single]:
        """A measured position: P becomes posterior but for its first block.

        Args:
            covariance: `(height, n)`, changed in place.
            position_gain: `(axes, n)`.
            inverse: `(axes, n)` of the innovation's variance.

        Returns:
            Gains `(axes, n)` of the higher derivatives.
        """
        blocks = covariance.reshape(len(self._noise), AXES, covariance.shape[1])
        gains = [blocks[derivative] * inverse for derivative in range(1, self._order)]
        for derivative in range(self._order - 1, 0, -1):
            start = self._first[derivative]
            row = blocks[start : start + self._order - derivative]
            row -= gains[derivative - 1] * blocks[derivative : self._order]
        cross = blocks[1 : self._order]
        cross -= position_gain * cross
        return gains
