"""The two learned parts: weights laid out as the kernels multiply them (`c/network.h`)."""

from __future__ import annotations

from typing import Final

import numpy as np

from hbbatch.errors import WeightsError
from hbbatch.motion.constants import HEADS, LARGEST_SAID, RESIDUAL_UNIT
from hbbatch.motion.parameters import Parameters
from hbbatch.packed.arrays import NONE, NOTHING, Single
from hbbatch.packed.features import Features

_TILE_ROWS: Final = 8
_MOST_ROWS: Final = 1024
"""Of inputs and outputs of all layers of a network: so much room the kernels have."""

NO_RESIDUAL: Final = (NOTHING, NONE, NONE, NONE)
NO_GAIN: Final = (NOTHING, NONE, NONE, NONE, NONE)


def residual_layers(
    parameters: Parameters, features: Features
) -> tuple[Single, Single, Single, Single]:
    """`ResidualPredictor`: limits of its input, encoder, hidden layer, outputs of all heads.

    Args:
        parameters: by their names in the module.
        features: what its input looks like here.

    Raises:
        WeightsError: the layers are too wide for the kernels.
    """
    encoder = features.layer(parameters["encoder.weight"], parameters["encoder.bias"])
    hidden, hidden_bias = parameters["heads_in.weight"], parameters["heads_in.bias"]
    names = [f"heads_out.{name}" for name in HEADS]
    heads = _beside_another([parameters[f"{name}.weight"] for name in names])
    biases = np.concatenate([parameters[f"{name}.bias"] for name in names])
    unit = np.array(list(RESIDUAL_UNIT.values()), np.float32)
    _check_room(features.rows.width, len(encoder), len(hidden), len(heads))
    return (
        features.limit,
        tiled(encoder),
        tiled(hidden, hidden_bias, _whole(len(encoder))),
        tiled(heads * unit[:, None], biases * unit, _whole(len(hidden))),
    )


def gain_layers(
    parameters: Parameters, features: Features
) -> tuple[Single, Single, Single, Single, Single]:
    """`GainNetwork`: limits, gates, what is remembered, candidate, and what is said of noise.

    What is said lies in [-1, 1]: factors' logarithms over `LARGEST_SAID`, of process and
    measurement; it has no layer where only the prediction was learned. The kernels have the
    hyperbolic tangent as 2 sigmoid(2 x) - 1; this 2 x is in the weights.

    Args:
        parameters: by their names in the module.
        features: what its input looks like here.

    Raises:
        WeightsError: the layers are too wide for the kernels.
    """
    given, kept = parameters["recurrent.weight_ih"], parameters["recurrent.weight_hh"]
    given_bias, kept_bias = parameters["recurrent.bias_ih"], parameters["recurrent.bias_hh"]
    memory = kept.shape[1]
    reset, keep, rest = (slice(i * memory, (i + 1) * memory) for i in range(3))
    both = features.layer(np.hstack([kept, given]), given_bias + kept_bias)
    forgetful = features.layer(np.hstack([np.zeros_like(kept), given]), given_bias)
    read_out, unit = parameters["read_out.weight"], np.float32(2.0 / LARGEST_SAID)
    read_out_bias = parameters["read_out.bias"]
    silent = not (read_out.any() or read_out_bias.any())
    _check_room(features.rows.width, *(4 * [memory]), len(read_out))
    return (
        features.limit,
        np.concatenate([tiled(both[reset]), tiled(both[keep])]),
        tiled(2.0 * kept[rest], 2.0 * kept_bias[rest]),
        tiled(2.0 * forgetful[rest, memory:]),
        NONE if silent else tiled(unit * read_out, unit * read_out_bias),
    )


def _check_room(inputs: int, *outputs: int) -> None:
    needed = inputs + sum(map(_whole, outputs))
    if needed > _MOST_ROWS:
        raise WeightsError(
            f"a network of {needed} rows, and the kernels have room for {_MOST_ROWS}: train with a "
            "smaller memory or narrower layers"
        )


def tiled(weights: Single, biases: Single | None = None, inputs: int | None = None) -> Single:
    """A layer as the kernels take it, `(tiles * (1 + inputs), 8)`.

    For each tile of eight outputs a row with their biases, then one for each input; what fills up
    the last tile, and inputs beyond those of the weights, are zeros.

    Args:
        weights: `(outputs, k)`.
        biases: `(outputs,)`, zeros by default.
        inputs: k at least, and k by default.
    """
    outputs, width = weights.shape
    whole = np.zeros((_whole(outputs), 1 + (inputs or width)), np.float32)
    whole[:outputs, 0] = 0.0 if biases is None else biases
    whole[:outputs, 1 : 1 + width] = weights
    tiles = whole.reshape(-1, _TILE_ROWS, whole.shape[1]).transpose(0, 2, 1)
    return np.ascontiguousarray(tiles).reshape(-1, _TILE_ROWS)


def _whole(outputs: int) -> int:
    """Outputs in whole tiles."""
    return -(-outputs // _TILE_ROWS) * _TILE_ROWS


def _beside_another(layers: list[Single]) -> Single:
    """Weights of layers with inputs of their own as those of one layer: block by block."""
    whole = np.zeros((sum(len(w) for w in layers), sum(w.shape[1] for w in layers)), np.float32)
    row = column = 0
    for weights in layers:
        below, beside = row + weights.shape[0], column + weights.shape[1]
        whole[row:below, column:beside] = weights
        row, column = below, beside
    return whole
