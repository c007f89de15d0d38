"""The two learned parts in numpy: weights packed into a few matrices."""

from __future__ import annotations

import numpy as np

from hbbatch.motion.constants import HEADS, LARGEST_SAID, RESIDUAL_UNIT
from hbbatch.motion.parameters import Parameters
from hbbatch.packed.kalman import Single


class PackedResidual:
    """`ResidualPredictor` as three matrices; a row of ones in each input carries the biases."""

    def __init__(self, parameters: Parameters) -> None:
        """Parameters by their names in the module."""
        self._encoder = _with_ones(_affine(parameters, "encoder"))
        self._heads_in = _with_ones(_affine(parameters, "heads_in"))
        heads = [_affine(parameters, f"heads_out.{name}") for name in HEADS]
        unit = np.array(RESIDUAL_UNIT, np.float32)[:, None]
        self._heads_out = _beside_another(heads) * unit
        self.inputs = self._encoder.shape[1]

    def __call__(self, features: Single) -> Single:
        """Rates `(7, n)`; the last row of features is ones."""
        encoded = _rectified(np.matmul(self._encoder, features))
        said = _rectified(np.matmul(self._heads_in, encoded))
        rates: Single = np.matmul(self._heads_out, said)
        return rates


class PackedGain:
    """`GainNetwork` with the gates' matrices side by side."""

    def __init__(self, parameters: Parameters) -> None:
        """Parameters by their names in the module."""
        given, kept = parameters["recurrent.weight_ih"], parameters["recurrent.weight_hh"]
        given_bias = parameters["recurrent.bias_ih"][:, None]
        kept_bias = parameters["recurrent.bias_hh"][:, None]
        self._memory = kept.shape[1]
        gates, rest = slice(0, 2 * self._memory), slice(2 * self._memory, None)
        # The sign is that of 1 / (1 + exp(-x)).
        self._gates = -np.hstack([kept, given_bias + kept_bias, given])[gates]
        self._candidate = np.hstack([given_bias, given])[rest].copy()
        self._kept = np.hstack([kept, kept_bias])[rest].copy()
        self._read_out = _affine(parameters, "read_out") / np.float32(LARGEST_SAID)
        self.inputs = self._gates.shape[1]

    def __call__(self, inputs: Single) -> tuple[Single, Single]:
        """New memory, and log factors `(8, n)` of process and measurement noise.

        Args:
            inputs: memory, a row of ones, features; the memory is replaced in place.
        """
        memory = inputs[: self._memory]
        gates = np.matmul(self._gates, inputs)
        np.exp(gates, out=gates)
        gates += 1.0
        np.reciprocal(gates, out=gates)
        reset, keep = gates[: self._memory], gates[self._memory :]
        remembered = np.matmul(self._kept, inputs[: self._memory + 1])
        remembered *= reset
        candidate = np.matmul(self._candidate, inputs[self._memory :])
        candidate += remembered
        np.tanh(candidate, out=candidate)
        memory -= candidate
        memory *= keep
        memory += candidate
        said = np.matmul(self._read_out, inputs[: self._memory + 1])
        np.tanh(said, out=said)
        said *= LARGEST_SAID
        return memory, said


def _rectified(outputs: Single) -> Single:
    # With a scalar zero numpy takes a path several times slower.
    return np.maximum(outputs, np.zeros_like(outputs), out=outputs)


def _affine(parameters: Parameters, layer: str) -> Single:
    """Weights and, in a last column, biases of a linear layer."""
    return np.hstack([parameters[f"{layer}.weight"], parameters[f"{layer}.bias"][:, None]])


def _with_ones(layer: Single) -> Single:
    """A layer whose last output is one, given inputs whose last row is ones."""
    ones = np.zeros_like(layer[:1])
    ones[0, -1] = 1.0
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
