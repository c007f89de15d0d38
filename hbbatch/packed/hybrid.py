"""The learned filter on a CPU."""

from __future__ import annotations

import numpy as np

from hbbatch.motion.columns import Columns
from hbbatch.motion.constants import AXES
from hbbatch.motion.parameters import HybridOptions, KalmanOptions, Parameters, part
from hbbatch.packed.features import predict_features, shared_rows, update_features
from hbbatch.packed.kalman import PackedKalman, by_kind, kalman_rows
from hbbatch.packed.network import gain_layers, residual_layers


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
        self._residual_layers = residual_layers(part(parameters, "residual"), before)
        self._gain_layers = gain_layers(part(parameters, "gain"), after)
