"""The learned filter for few rows on a CPU: numpy, weights packed into a few matrices."""

from __future__ import annotations

from typing import cast

import numpy as np
import torch
from torch import Tensor, nn

from hbbatch.boxes import FloatArray
from hbbatch.model.columns import Columns
from hbbatch.model.filters import AXES, SMALLEST_SIZE_M
from hbbatch.model.geometry import turn
from hbbatch.model.hybrid import FEATURE_LIMIT, LONGEST_TIME_S, HybridFilter
from hbbatch.model.kalman import KalmanFilter
from hbbatch.model.network import LARGEST_SAID, GainNetwork, ResidualPredictor
from hbbatch.model.packed import (
    DETECTION,
    IntArray,
    PackedFilter,
    PackedInnovation,
    PackedKalman,
    Single,
    move,
    wrap_half_turn,
)

_CENTRE_AND_YAW = [0, 1, 2, 6]


def packed(motion: KalmanFilter | HybridFilter) -> PackedFilter:
    """The packed twin of a filter, with its parameters as they are now."""
    return PackedKalman(motion) if isinstance(motion, KalmanFilter) else PackedHybrid(motion)


class PackedHybrid:
    """`HybridFilter`, packed. State: the base's, then the module's other columns, then its kind."""

    @torch.no_grad()
    def __init__(self, motion: HybridFilter) -> None:
        """Take the parameters as they are now."""
        self._base = PackedKalman(motion.base)
        self._velocity = motion.base.columns["velocity"]
        covariance = motion.base.columns["covariance"].start
        self._spread = slice(covariance, covariance + AXES)
        self._kind_rows = np.eye(len(motion.class_names), dtype=np.float32)
        self._memory = motion.gain.recurrent.hidden_size
        self._columns = Columns(
            {
                "base": self._base.height,
                "log_noise": AXES,
                "kind": len(motion.class_names),
                "memory": self._memory,
                "history": 7 * motion.history,
                "correction": 7,
                "process": AXES,
                "counters": 2,
                "dt_s": 1,
            }
        )
        self.height = self._columns.width
        self._log_q = motion.base.log_q.detach().numpy().T
        self._residual = _Residual(motion.residual)
        self._gain = _Gain(motion.gain)
        self._rate_unit = _column(motion.rate_unit)
        self._innovation_unit = _column(motion.innovation_unit)

    def detections(self, sight_m: FloatArray, kinds: IntArray) -> Single:
        """See `PackedFilter.detections`."""
        return self._base.detections(sight_m, kinds)

    def birth(self, seen: Single, kinds: IntArray) -> Single:
        """See `PackedFilter.birth`; the memory starts empty."""
        state = np.zeros((self.height, len(kinds)), np.float32)
        state[self._columns["base"]] = self._base.birth(seen, kinds)
        state[self._columns["log_noise"]] = self._log_q[:, kinds]
        state[self._columns["kind"]] = self._kind_rows[:, kinds]
        return state

    def predict(self, boxes: FloatArray, state: Single, dt_s: Single) -> FloatArray:
        """See `PackedFilter.predict`."""
        column = self._columns
        heading = boxes[6].astype(np.float32)
        cos, sin = np.cos(heading), np.sin(heading)
        step = self._residual(self._predict_features(boxes, state, dt_s, cos, sin)) * dt_s
        noise = np.exp(state[column["log_noise"]] + state[column["process"]])
        prior = self._base.predict_with(boxes, state[column["base"]], dt_s, noise)
        move(prior, step[_CENTRE_AND_YAW], step[3:6], cos, sin)
        history = state[column["history"]]
        history[7:] = history[:-7].copy()
        history[:7] = (prior - boxes) / dt_s
        state[column["counters"]] += dt_s
        state[column["dt_s"]] = dt_s
        return prior

    def _predict_features(
        self, boxes: FloatArray, state: Single, dt_s: Single, cos: Single, sin: Single
    ) -> Single:
        column = self._columns
        features = np.empty((self._residual.inputs, len(dt_s)), np.float32)
        memory, rest = np.split(features, [self._memory])
        memory[:] = state[column["memory"]]
        history = state[column["history"]]
        rates = rest[: len(history)].reshape(-1, 7, len(dt_s))
        rates[:] = history.reshape(rates.shape)
        rates[:, 0], rates[:, 1] = turn(rates[:, 0], rates[:, 1], cos, -sin)
        rates /= self._rate_unit
        rest = rest[len(history) :]
        np.divide(state[column["correction"]], self._innovation_unit, out=rest[:7])
        velocity = state[self._velocity]
        rest[7], rest[8] = turn(velocity[0], velocity[1], cos, -sin)
        rest[9:11] = velocity[2:]
        rest[7:11] /= self._rate_unit[_CENTRE_AND_YAW]
        rest[11:13] = _counters(state[column["counters"]])
        rest[13] = dt_s * 10.0
        rest[14:17] = _log_size(boxes)
        rest[17:-1] = state[column["kind"]]
        rest[-1] = 1.0
        _limit(features[self._memory :])
        return features

    def update(self, boxes: FloatArray, state: Single, measured: FloatArray, seen: Single) -> None:
        """See `PackedFilter.update`."""
        column = self._columns
        new = PackedInnovation(boxes, measured)
        prior = boxes.copy()
        inputs = self._update_inputs(boxes, state, new, seen)
        state[column["memory"]], said = self._gain(inputs)
        state[column["process"]] = said[:AXES]
        variance = seen[DETECTION["variance"]] * np.exp(said[AXES:])
        self._base.update_with(boxes, state[column["base"]], new, variance, seen)
        correction = (boxes - prior).astype(np.float32)
        correction[6] = wrap_half_turn(correction[6])
        state[column["history"]][:7] += correction / state[column["dt_s"]]
        correction[0], correction[1] = turn(correction[0], correction[1], new.cos, -new.sin)
        state[column["correction"]] = correction
        state[column["counters"].start] = 0.0

    def _update_inputs(
        self, prior: FloatArray, state: Single, new: PackedInnovation, seen: Single
    ) -> Single:
        """Memory, a row of ones, features."""
        column = self._columns
        inputs = np.empty((self._gain.inputs, prior.shape[1]), np.float32)
        inputs[: self._memory] = state[column["memory"]]
        inputs[self._memory] = 1.0
        features = inputs[self._memory + 1 :]
        features[:AXES] = new.motion
        features[AXES:7] = new.size
        features[7:14] = state[column["correction"]]
        both = features[:14].reshape(2, 7, -1)
        both /= self._innovation_unit
        np.multiply(np.log(state[self._spread]), 0.25, out=features[14:18])
        features[18:20] = _counters(state[column["counters"]])
        ahead = seen[DETECTION["ahead"]]
        features[20], features[21] = turn(ahead[0], ahead[1], new.cos, -new.sin)
        features[22:24] = seen[DETECTION["range"]]
        features[24:27] = _log_size(prior)
        features[27:] = state[column["kind"]]
        _limit(features)
        return inputs

    def velocity(self, state: Single) -> Single:
        """See `PackedFilter.velocity`."""
        return state[self._velocity][:3]


class _Residual:
    """`ResidualPredictor` as three matrices; a row of ones in each input carries the biases."""

    def __init__(self, network: ResidualPredictor) -> None:
        self._encoder = _with_ones(_affine(network.encoder))
        self._heads_in = _with_ones(_affine(network.heads_in))
        heads = [_affine(cast("nn.Linear", layer)) for layer in network.heads_out.values()]
        weights = torch.block_diag(*(head[:, :-1] for head in heads))  # type: ignore[no-untyped-call]
        biases = torch.cat([head[:, -1:] for head in heads])
        self._heads_out = torch.hstack([weights, biases]) * network.unit[:, None]
        self.inputs = self._encoder.shape[1]

    def __call__(self, features: Single) -> Single:
        """Rates `(7, n)`; the last row of features is ones."""
        encoded = _rectified(_product(self._encoder, features))
        return _product(self._heads_out, _rectified(_product(self._heads_in, encoded)))


class _Gain:
    """`GainNetwork` with the gates' matrices side by side."""

    def __init__(self, network: GainNetwork) -> None:
        recurrent = network.recurrent
        self._memory = recurrent.hidden_size
        given, kept = recurrent.weight_ih, recurrent.weight_hh
        given_bias, kept_bias = recurrent.bias_ih[:, None], recurrent.bias_hh[:, None]
        gates, rest = slice(0, 2 * self._memory), slice(2 * self._memory, None)
        # The sign is that of 1 / (1 + exp(-x)).
        self._gates = -torch.hstack([kept, given_bias + kept_bias, given])[gates]
        self._candidate = torch.hstack([given_bias, given])[rest].clone()
        self._kept = torch.hstack([kept, kept_bias])[rest].clone()
        self._read_out = _affine(network.read_out) / LARGEST_SAID
        self.inputs = self._gates.shape[1]

    def __call__(self, inputs: Single) -> tuple[Single, Single]:
        """New memory, and log factors `(8, n)` of process and measurement noise.

        Args:
            inputs: memory, a row of ones, features; the memory is replaced in place.
        """
        memory = inputs[: self._memory]
        gates = _product(self._gates, inputs)
        np.exp(gates, out=gates)
        gates += 1.0
        np.reciprocal(gates, out=gates)
        reset, keep = gates[: self._memory], gates[self._memory :]
        remembered = _product(self._kept, inputs[: self._memory + 1])
        remembered *= reset
        candidate = _product(self._candidate, inputs[self._memory :])
        candidate += remembered
        np.tanh(candidate, out=candidate)
        memory -= candidate
        memory *= keep
        memory += candidate
        said = _product(self._read_out, inputs[: self._memory + 1])
        np.tanh(said, out=said)
        said *= LARGEST_SAID
        return memory, said


def _product(layer: Tensor, inputs: Single) -> Single:
    """Matrix product by torch, which computes in as many threads as the process was told to."""
    product: Single = torch.mm(layer, torch.from_numpy(inputs)).numpy()
    return product


def _rectified(outputs: Single) -> Single:
    # With a scalar zero numpy takes a path several times slower.
    return np.maximum(outputs, np.zeros_like(outputs), out=outputs)


def _limit(features: Single) -> None:
    np.clip(features, -FEATURE_LIMIT, FEATURE_LIMIT, out=features)


def _log_size(boxes: FloatArray) -> Single:
    size: Single = np.log(np.maximum(boxes[3:6], SMALLEST_SIZE_M)).astype(np.float32)
    return size


def _counters(seconds: Single) -> Single:
    counters: Single = np.log1p(10.0 * np.minimum(seconds, LONGEST_TIME_S))
    counters *= 0.5
    return counters


def _affine(layer: nn.Linear) -> Tensor:
    """Weights and, in a last column, biases of a linear layer."""
    return torch.hstack([layer.weight, layer.bias[:, None]])


def _with_ones(layer: Tensor) -> Tensor:
    """A layer whose last output is one, given inputs whose last row is ones."""
    ones = torch.zeros_like(layer[:1])
    ones[0, -1] = 1.0
    return torch.cat([layer, ones])


def _column(parameter: Tensor) -> Single:
    column: Single = parameter.numpy()[:, None]
    return column
