"""The learned filter for few rows on a CPU: numpy, weights packed into a few matrices."""

from __future__ import annotations

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.motion.columns import Columns, kalman_columns
from hbbatch.motion.constants import (
    AXES,
    FEATURE_LIMIT,
    INNOVATION_UNIT,
    LONGEST_TIME_S,
    RATE_UNIT,
    SMALLEST_SIZE_M,
)
from hbbatch.motion.parameters import HybridOptions, KalmanOptions, Parameters, part
from hbbatch.motion.turns import turn
from hbbatch.packed.kalman import (
    DETECTION,
    IntArray,
    PackedInnovation,
    PackedKalman,
    Single,
    by_kind,
    move,
    wrap_half_turn,
)
from hbbatch.packed.network import PackedGain, PackedResidual

_CENTRE_AND_YAW = [0, 1, 2, 6]


class PackedHybrid:
    """`model.hybrid.HybridFilter`, packed.

    State: the base's, then the module's other columns, then its kind.
    """

    def __init__(self, parameters: Parameters, kinds: int, options: HybridOptions) -> None:
        """Parameters of the shapes that the options ask for."""
        base = part(parameters, "base")
        self._base = PackedKalman(base, KalmanOptions(options.motion_model))
        columns = kalman_columns(options.motion_model)
        self._velocity = columns["velocity"]
        covariance = columns["covariance"].start
        self._spread = slice(covariance, covariance + AXES)
        self._kind_rows = np.eye(kinds, dtype=np.float32)
        self._memory = options.memory
        self._columns = Columns(
            {
                "base": self._base.height,
                "log_noise": AXES,
                "kind": kinds,
                "memory": self._memory,
                "history": 7 * options.history,
                "correction": 7,
                "process": AXES,
                "counters": 2,
                "dt_s": 1,
            }
        )
        self.height = self._columns.width
        self._log_q = by_kind(base["log_q"])
        self._residual = PackedResidual(part(parameters, "residual"))
        self._gain = PackedGain(part(parameters, "gain"))
        self._rate_unit = _column(RATE_UNIT)
        self._innovation_unit = _column(INNOVATION_UNIT)

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


def _limit(features: Single) -> None:
    np.clip(features, -FEATURE_LIMIT, FEATURE_LIMIT, out=features)


def _log_size(boxes: FloatArray) -> Single:
    size: Single = np.log(np.maximum(boxes[3:6], SMALLEST_SIZE_M)).astype(np.float32)
    return size


def _counters(seconds: Single) -> Single:
    counters: Single = np.log1p(10.0 * np.minimum(seconds, LONGEST_TIME_S))
    counters *= 0.5
    return counters


def _column(values: tuple[float, ...]) -> Single:
    return np.array(values, np.float32)[:, None]
