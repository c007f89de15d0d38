"""The two learned parts: weights packed into a few matrices, products in numpy.

`dot` costs a small product half a microsecond less than `matmul`.
"""

from __future__ import annotations

import numpy as np

from hbbatch.motion.constants import HEADS, LARGEST_SAID, RESIDUAL_UNIT
from hbbatch.motion.parameters import Parameters
from hbbatch.packed import kernels
from hbbatch.packed.arrays import NONE, Single
from hbbatch.packed.features import Features


class PackedResidual:
    """`ResidualPredictor` as three matrices; a row of ones in each input carries the biases.

    Rectified outputs are twice what they are in the module, and the next layer's weights half.
    """

    def __init__(self, parameters: Parameters, features: Features) -> None:
        """Parameters by their names in the module, and what its input looks like here."""
        encoder = features.layer(parameters["encoder.weight"], parameters["encoder.bias"])
        one = features.rows["one"].start
        self._encoder = _with_ones(encoder, one)
        heads_in = _affine(parameters, "heads_in")
        self._heads_in = _with_ones(heads_in, heads_in.shape[1] - 1) * np.float32(0.5)
        heads = [_affine(parameters, f"heads_out.{name}") for name in HEADS]
        unit = np.array(list(RESIDUAL_UNIT.values()), np.float32)[:, None]
        self._heads_out = _beside_another(heads) * (0.5 * unit)

    def __call__(self, features: Single) -> Single:
        """Rates `(3, n)` along, across and of yaw."""
        encoded: Single = self._encoder.dot(features)
        kernels.rectify(encoded)
        said: Single = self._heads_in.dot(encoded)
        kernels.rectify(said)
        rates: Single = self._heads_out.dot(said)
        return rates


class PackedGain:
    """`GainNetwork` with the gates' matrices side by side.

    Gates are 0.5 + 0.5·tanh(x / 2), the module's sigmoid, for numpy has a fast tanh.
    """

    def __init__(self, parameters: Parameters, features: Features) -> None:
        """Parameters by their names in the module, and what its input looks like here."""
        given, kept = parameters["recurrent.weight_ih"], parameters["recurrent.weight_hh"]
        given_bias, kept_bias = parameters["recurrent.bias_ih"], parameters["recurrent.bias_hh"]
        self._memory = kept.shape[1]
        gates, rest = slice(0, 2 * self._memory), slice(2 * self._memory, None)
        both = features.layer(np.hstack([kept, given]), given_bias + kept_bias)
        self._gates = 0.5 * both[gates]
        forgetful = features.layer(np.hstack([np.zeros_like(kept), given]), given_bias)
        self._candidate = forgetful[rest, self._memory :].copy()
        self._kept = np.hstack([kept, kept_bias[:, None]])[rest].copy()
        self._read_out = _affine(parameters, "read_out") / np.float32(LARGEST_SAID)
        self._silent = not self._read_out.any()

    def __call__(self, features: Single) -> Single:
        """Replaces the memory, which the features begin with; what is said of noise, `(8, n)`.

        That is in [-1, 1]: factors' logarithms over `LARGEST_SAID`, of process and measurement.
        Nothing, where only the prediction was learned.
        """
        with_one = features[: self._memory + 1]
        gates: Single = self._gates.dot(features)
        np.tanh(gates, out=gates)
        remembered: Single = self._kept.dot(with_one)
        candidate: Single = self._candidate.dot(features[self._memory :])
        kernels.reset_memory(gates, remembered, candidate)
        np.tanh(candidate, out=candidate)
        kernels.mix_memory(gates, candidate, features)
        if self._silent:
            return NONE
        said: Single = self._read_out.dot(with_one)
        np.tanh(said, out=said)
        return said


def _affine(parameters: Parameters, layer: str) -> Single:
    """Weights and, in a last column, biases of a linear layer."""
    return np.hstack([parameters[f"{layer}.weight"], parameters[f"{layer}.bias"][:, None]])


def _with_ones(layer: Single, one: int) -> Single:
    """A layer with one more output, which is one where row `one` of the input is."""
    ones = np.zeros_like(layer[:1])
    ones[0, one] = 1.0
    return np.concatenate([layer, ones])


def _beside_another(layers: list[Single]) -> Single:
    """Layers with inputs of their own as one layer: weights block by block, then all biases."""
    inputs = sum(layer.shape[1] - 1 for layer in layers)
    whole = np.zeros((sum(len(layer) for layer in layers), inputs + 1), np.float32)
    row = column = 0
    for layer in layers:
        outputs, width = len(layer), layer.shape[1] - 1
        whole[row : row + outputs, column : column + width] = layer[:, :-1]
        whole[row : row + outputs, -1] = layer[:, -1]
        row, column = row + outputs, column + width
    return whole
