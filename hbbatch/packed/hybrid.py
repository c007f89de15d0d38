"""The learned filter for few rows on a CPU: numpy, weights packed into a few matrices."""

from __future__ import annotations

from typing import Final

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.motion.columns import Columns
from hbbatch.motion.constants import AXES, LONGEST_TIME_S, SMALLEST_SIZE_M
from hbbatch.motion.parameters import HybridOptions, KalmanOptions, Parameters, part
from hbbatch.packed.arrays import (
    MOTION,
    PLAN,
    SIZE,
    YAW_ROW,
    Heading,
    IntArray,
    Single,
    difference,
    keep_sizes,
)
from hbbatch.packed.features import predict_features, shared_rows, update_features
from hbbatch.packed.kalman import (
    BOX_VARIANCE,
    DETECTION,
    TIMES,
    PackedKalman,
    by_kind,
    kalman_rows,
)
from hbbatch.packed.network import PackedGain, PackedResidual

_FROM_SENSOR: Final = slice(DETECTION["range"].start, DETECTION["ahead"].stop)


class PackedHybrid:
    """`model.hybrid.HybridFilter`, packed.

    State: first what the networks see, laid out as they see it (`packed.features`), then the rest.
    Features are kept as they are; units are in the weights.
    """

    def __init__(self, parameters: Parameters, kinds: int, options: HybridOptions) -> None:
        """Parameters of the shapes that the options ask for."""
        before, after = predict_features(kinds, options), update_features(kinds, options)
        base = kalman_rows(options.motion_model)
        self._rows = Columns(
            {
                **shared_rows(kinds, options),
                "tenths": 1,
                "velocity": base.pop("velocity"),
                "history": 7 * options.history,
                **base,
                "q": AXES,
                "learned": 1,
                "counters": 2,
                "inverse_dt": 1,
            }
        )
        self.height = self._rows.width
        model = KalmanOptions(options.motion_model)
        self._base = PackedKalman(part(parameters, "base"), model, self._rows)
        newborn = self._base.newborn
        newborn[self._rows["one"]] = 1.0
        newborn[self._rows["kind"]] = np.eye(kinds)
        newborn[self._rows["q"]] = np.exp(by_kind(parameters["base.log_q"]))
        newborn[self._rows["learned"]] = options.learned_kinds(kinds)
        self._residual = PackedResidual(part(parameters, "residual"), before)
        self._gain = PackedGain(part(parameters, "gain"), after)
        self._before, self._after = before, after
        self._entries = 1 + options.history

    def times(self, dt_s: Single) -> Single:
        """See `PackedFilter.times`."""
        return self._base.times(dt_s)

    def detections(self, sight_m: FloatArray, kinds: IntArray) -> Single:
        """See `PackedFilter.detections`."""
        return self._base.detections(sight_m, kinds)

    def birth(self, boxes: FloatArray, seen: Single, kinds: IntArray) -> Single:
        """See `PackedFilter.birth`; the memory starts empty."""
        state = self._base.birth(boxes, seen, kinds)
        state[self._rows["log_size"]] = np.log(np.maximum(boxes[SIZE], SMALLEST_SIZE_M))
        return state

    def predict(self, boxes: FloatArray, state: Single, times: Single) -> FloatArray:
        """See `PackedFilter.predict`."""
        rows = self._rows
        heading = Heading.of(boxes[YAW_ROW])
        state[rows["tenths"]] = times[TIMES.tenths]
        rate = self._residual(self._predict_features(state, heading))
        rate *= state[rows["learned"]]
        keep_sizes(boxes, rate, times[TIMES.inverse])
        heading.turn(rate[PLAN])
        rate[MOTION] += self._base.advance(state, times)
        history = state[rows["history"]]
        history[7:] = history[:-7]
        history[:7] = rate
        prior: FloatArray = boxes + rate * times[TIMES.dt_s]
        np.log(prior[SIZE], out=state[rows["log_size"]], casting="same_kind")
        counters, elapsed = state[rows["counters"]], state[rows["elapsed"]]
        counters += times[TIMES.tenths]
        np.minimum(counters, 10.0 * LONGEST_TIME_S, out=elapsed)
        np.log1p(elapsed, out=elapsed)
        state[rows["inverse_dt"]] = times[TIMES.inverse]
        return prior

    def _predict_features(self, state: Single, heading: Heading) -> Single:
        """Velocity and history in the heading frame, all else as it is."""
        rows = self._rows
        features = state[: rows["history"].stop].copy()
        # Elapsed and tenths are as many rows as a size, so velocity is laid out like a rate.
        rates = features[rows["elapsed"].start :].reshape(self._entries, 7, state.shape[1])
        heading.turn_back(rates[:, PLAN])
        return self._before.limited(features)

    def update(self, boxes: FloatArray, state: Single, measured: FloatArray, seen: Single) -> None:
        """See `PackedFilter.update`."""
        rows = self._rows
        heading = Heading.of(boxes[YAW_ROW])
        apart, agreement = difference(measured, boxes)
        features, innovation = self._update_features(state, apart, seen, heading)
        memory, factors = self._gain(features, state[rows["learned"]])
        state[rows["memory"]] = memory
        np.multiply(state[rows["q"]], factors[:AXES], out=state[rows["noise"]])
        variance = seen[BOX_VARIANCE].copy()
        variance[MOTION] *= factors[AXES:]
        change = self._base.correct(boxes, state, innovation, variance)
        state[rows["correction"]] = change[:7]
        self._base.apply(boxes, state, change, heading)
        self._base.settle_heading(boxes, state, agreement)
        state[rows["history"]][:7] += change[:7] * state[rows["inverse_dt"]]
        np.log(boxes[SIZE], out=state[rows["log_size"]], casting="same_kind")
        state[rows["counters"].start] = 0.0
        state[rows["elapsed"].start] = 0.0

    def _update_features(
        self, state: Single, apart: FloatArray, seen: Single, heading: Heading
    ) -> tuple[Single, Single]:
        """What the gain network sees; and the innovation beyond its limits."""
        after, shared = self._after.rows, self._rows["elapsed"].stop
        features = np.empty((after.width, apart.shape[1]), np.float32)
        features[:shared] = state[:shared]
        features[after["innovation"]] = apart
        features[after["from_sensor"]] = seen[_FROM_SENSOR]
        # The innovation's plan lies six rows before the direction from the sensor.
        both = features[shared : shared + 12].reshape(2, 6, apart.shape[1])
        heading.turn_back(both[:, PLAN])
        spread = self._rows["covariance"].start
        np.log(state[spread : spread + AXES], out=features[after["log_spread"]])
        innovation = features[after["innovation"]].copy()
        return self._after.limited(features), innovation

    def velocity(self, state: Single) -> Single:
        """See `PackedFilter.velocity`."""
        return self._base.velocity(state)
