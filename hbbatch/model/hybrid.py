"""HybridTrack's learnable Kalman filter: a motion model, a learned residual, a learned gain.

Prior: x̂ = x + S, where S is the motion model's step plus the residual predicted from the last P
posterior differences, the last correction and the recurrent memory. Posterior:
x = x̂ + K·innovation, where K follows from covariances whose noises the recurrent network scales
(Di Bella et al. 2025, section III).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from hbbatch.model.filters import (
    Innovation,
    Measurement,
    innovation,
    plan_range,
)
from hbbatch.model.geometry import wrap_half_turn
from hbbatch.model.kalman import KalmanFilter
from hbbatch.model.network import GainNetwork, ResidualPredictor
from hbbatch.motion.columns import Columns, MotionModel
from hbbatch.motion.constants import (
    AXES,
    FEATURE_LIMIT,
    INNOVATION_UNIT,
    LONGEST_TIME_S,
    RANGE_UNIT_M,
    RATE_UNIT,
    SMALLEST_SIZE_M,
)
from hbbatch.motion.parameters import HybridOptions
from hbbatch.motion.turns import turn


class HybridFilter(nn.Module):
    """Rows: the base filter's, then memory, history of posterior rates, correction, counters."""

    innovation_unit: Tensor
    rate_unit: Tensor
    kind_rows: Tensor
    learned: Tensor

    def __init__(
        self,
        class_names: tuple[str, ...],
        motion_model: MotionModel = "ct",
        history: int = 4,
        memory: int = 64,
        hidden: int = 64,
        head: int = 32,
        learned: Sequence[bool] = (),
    ) -> None:
        """Make an untrained filter.

        Args:
            class_names: kinds of road users it is conditioned on.
            motion_model: of the classical base.
            history: P, posterior differences the residual predictor sees.
            memory: units of the recurrent state.
            hidden: units of the encoder.
            head: units of each head.
            learned: for each kind whether its motion is learned; the others keep the classical
                base. By default all are.
        """
        super().__init__()
        self.class_names = class_names
        self.base = KalmanFilter(class_names, motion_model)
        self.history = history
        self.columns = Columns(
            {
                "base": self.base.width,
                "memory": memory,
                "history": 7 * history,
                "correction": 7,
                "process": AXES,
                "since_seen_s": 1,
                "age_s": 1,
                "dt_s": 1,
            }
        )
        self.width = self.columns.width
        kinds = len(class_names)
        seen_before = memory + 7 * history + 7 + AXES + 2 + 1 + 3 + kinds
        self.residual = ResidualPredictor(seen_before, hidden, head)
        self.gain = GainNetwork(7 + 7 + AXES + 2 + 2 + 2 + 3 + kinds, memory)
        self.register_buffer("innovation_unit", torch.tensor(INNOVATION_UNIT), persistent=False)
        self.register_buffer("rate_unit", torch.tensor(RATE_UNIT), persistent=False)
        self.register_buffer("kind_rows", torch.eye(kinds), persistent=False)
        chosen = HybridOptions(learned=learned).learned_kinds(kinds)
        self.register_buffer("learned", torch.tensor(chosen)[:, None], persistent=False)

    def birth(self, measurement: Measurement, class_code: Tensor) -> Tensor:
        """Rows `(n, width)` of tracks born from detections; the memory starts empty."""
        base = self.base.birth(measurement, class_code)
        return nn.functional.pad(base, (0, self.width - base.shape[1]))

    def predict(self, boxes: Tensor, rows: Tensor, dt_s: Tensor) -> tuple[Tensor, Tensor]:
        """Prior boxes and rows `dt_s` seconds later."""
        column = self.columns
        base = rows[:, column["base"]]
        heading = boxes[:, 6:7].float()
        cos, sin = torch.cos(heading), torch.sin(heading)
        rates = self.residual(self._predict_features(boxes, rows, base, dt_s, cos, sin))
        code = base[:, -1].long()
        noise = (self.base.log_q[code] + rows[:, column["process"]]).exp()
        prior, base = self.base.predict_with(boxes, base, dt_s, noise)
        dt = dt_s[:, None]
        step = rates * self.learned[code] * dt
        x, y = turn(step[:, 0:1], step[:, 1:2], cos, sin)
        prior = prior + torch.cat([x, y, torch.zeros_like(boxes[:, 2:6]), step[:, 2:3]], dim=1)
        newest = ((prior - boxes) / dt).float()
        past = rows[:, column["history"]][:, : 7 * (self.history - 1)]
        middle = rows[:, column["correction"].start : column["since_seen_s"].start]
        waited = rows[:, column["since_seen_s"]] + dt
        age = rows[:, column["age_s"]] + dt
        memory = rows[:, column["memory"]]
        return prior, torch.cat([base, memory, newest, past, middle, waited, age, dt], dim=1)

    def _predict_features(
        self, boxes: Tensor, rows: Tensor, base: Tensor, dt_s: Tensor, cos: Tensor, sin: Tensor
    ) -> Tensor:
        column = self.columns
        past = rows[:, column["history"]].reshape(len(rows), self.history, 7)
        along, across = turn(past[..., 0], past[..., 1], cos, -sin)
        local = torch.cat([along[..., None], across[..., None], past[..., 2:]], dim=2)
        velocity = base[:, self.base.columns["velocity"]]
        forward, sideways = turn(velocity[:, 0:1], velocity[:, 1:2], cos, -sin)
        features = [
            rows[:, column["memory"]],
            (local / self.rate_unit).flatten(1),
            rows[:, column["correction"]] / self.innovation_unit,
            torch.cat([forward, sideways, velocity[:, 2:]], dim=1) / self.rate_unit[[0, 1, 2, 6]],
            _counters(rows[:, column["since_seen_s"]], rows[:, column["age_s"]]),
            dt_s[:, None] * 10.0,
            _log_size(boxes),
            self.kind_rows[base[:, -1].long()],
        ]
        return torch.cat(features, dim=1).clamp(-FEATURE_LIMIT, FEATURE_LIMIT)

    def update(self, prior: Tensor, rows: Tensor, seen: Measurement) -> tuple[Tensor, Tensor]:
        """Posterior boxes and rows after a matched detection."""
        column = self.columns
        base = rows[:, column["base"]]
        new = innovation(prior, seen.boxes)
        features = self._update_features(prior, rows, base, new, seen)
        trust = self.gain(features, rows[:, column["memory"]])
        code = base[:, -1].long()
        learned = self.learned[code]
        variance, size_variance = self.base.measurement_variance(seen, code)
        posterior, base = self.base.update_with(
            prior, base, new, variance * (learned * trust.measured).exp(), size_variance
        )
        correction = (posterior - prior).float()
        turned = wrap_half_turn(correction[:, 6:7])
        correction = torch.cat([correction[:, :6], turned], dim=1)
        past = rows[:, column["history"]]
        dt = rows[:, column["dt_s"]]
        newest = past[:, :7] + correction / dt
        along, across = turn(correction[:, 0:1], correction[:, 1:2], new.cos, -new.sin)
        local = torch.cat([along, across, correction[:, 2:]], dim=1)
        age = rows[:, column["age_s"]]
        return posterior, torch.cat(
            [
                *(base, trust.memory, newest, past[:, 7:], local, learned * trust.process),
                *(torch.zeros_like(age), age, dt),
            ],
            dim=1,
        )

    def _update_features(
        self, prior: Tensor, rows: Tensor, base: Tensor, new: Innovation, seen: Measurement
    ) -> Tensor:
        column = self.columns
        distance = plan_range(seen.sight_m)
        along, across = turn(seen.sight_m[:, 0:1], seen.sight_m[:, 1:2], new.cos, -new.sin)
        spread = base[:, self.base.columns["covariance"]][:, :AXES]
        features = [
            torch.cat([new.motion, new.size], dim=1) / self.innovation_unit,
            rows[:, column["correction"]] / self.innovation_unit,
            torch.log(spread) * 0.25,
            _counters(rows[:, column["since_seen_s"]], rows[:, column["age_s"]]),
            torch.cat([along, across], dim=1) / distance,
            torch.cat([distance / RANGE_UNIT_M, seen.sight_m[:, 2:]], dim=1),
            _log_size(prior),
            self.kind_rows[base[:, -1].long()],
        ]
        return torch.cat(features, dim=1).clamp(-FEATURE_LIMIT, FEATURE_LIMIT)

    def velocity(self, rows: Tensor) -> Tensor:
        """`(n, 3)` velocity in the world frame, m/s."""
        return self.base.velocity(rows[:, self.columns["base"]])


def _log_size(boxes: Tensor) -> Tensor:
    return torch.log(boxes[:, 3:6].clamp(min=SMALLEST_SIZE_M)).float()


def _counters(since_seen_s: Tensor, age_s: Tensor) -> Tensor:
    """Time since the last detection and age, compressed; what training never saw is cut off."""
    both = torch.cat([since_seen_s, age_s], dim=1).clamp(max=LONGEST_TIME_S)
    return torch.log1p(10.0 * both) * 0.5
