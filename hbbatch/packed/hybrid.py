"""The learned filter on a CPU: matrix products in numpy, what lies between them compiled."""

from __future__ import annotations

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.motion.columns import Columns
from hbbatch.motion.constants import AXES
from hbbatch.motion.parameters import HybridOptions, KalmanOptions, Parameters, part
from hbbatch.packed import kernels
from hbbatch.packed.arrays import IntArray, Single
from hbbatch.packed.features import predict_features, shared_rows, update_features
from hbbatch.packed.kalman import APART_ROWS, PackedKalman, by_kind, kalman_rows
from hbbatch.packed.network import PackedGain, PackedResidual


class PackedHybrid(PackedKalman):
    """`model.hybrid.HybridFilter`, packed.

    State: first what the networks see, laid out as they see it (`packed.features`), then the rest.
    Features are kept as they are; units are in the weights.
    """

    def __init__(self, parameters: Parameters, kinds: int, options: HybridOptions) -> None:
        """Parameters of the shapes that the options ask for."""
        before, after = predict_features(kinds, options), update_features(kinds, options)
        base = kalman_rows(options.motion_model)
        rows = Columns(
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
        super().__init__(part(parameters, "base"), KalmanOptions(options.motion_model), rows)
        self.newborn[rows["one"]] = 1.0
        self.newborn[rows["kind"]] = np.eye(kinds)
        self.newborn[rows["q"]] = np.exp(by_kind(parameters["base.log_q"]))
        self.newborn[rows["learned"]] = options.learned_kinds(kinds)
        self._residual = PackedResidual(part(parameters, "residual"), before)
        self._gain = PackedGain(part(parameters, "gain"), after)
        self._before, self._after = before, after

    def predict(
        self,
        boxes: FloatArray,
        state: Single,
        times: Single,
        frames: IntArray,
        damping: FloatArray | None,
    ) -> FloatArray:
        """See `PackedKalman.predict`."""
        features = np.empty((self._before.rows.width, len(frames)), np.float32)
        kernels.predict_features(
            self.layout, boxes, state, times, frames, self._before.limit, features
        )
        rates = self._residual(features)
        return self._advance(boxes, state, times, frames, damping, rates)

    def update(
        self,
        boxes: FloatArray,
        state: Single,
        measured: FloatArray,
        seen: Single,
        detections: IntArray,
    ) -> None:
        """See `PackedKalman.update`."""
        layout, limit = self.layout, self._after.limit
        apart = np.empty((APART_ROWS, len(detections)), np.float32)
        features = np.empty((self._after.rows.width, len(detections)), np.float32)
        kernels.update_features(
            layout, boxes, state, measured, seen, detections, limit, apart, features
        )
        said = self._gain(features)
        kernels.update(layout, boxes, state, seen, detections, apart, features, said)
