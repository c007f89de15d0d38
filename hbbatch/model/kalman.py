"""The classical Kalman filter: the baseline to beat, and the base of the learned one.

Along, across, up and yaw are independent axes in the heading frame; length, width and height are
random walks. Three motion models: constant velocity (`cv`), constant acceleration (`ca`) and
coordinated turn (`ct`: the velocity vector turns with the yaw rate). All noise is per class and
fitted by likelihood (`hbbatch.model.likelihood`).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from hbbatch.model.blocks import blocks, initial, join
from hbbatch.model.filters import (
    Innovation,
    Measurement,
    innovation,
    moved,
    plan_range,
    settle_heading,
)
from hbbatch.motion import covariance as cov
from hbbatch.motion.columns import MotionModel, kalman_columns, kalman_order
from hbbatch.motion.constants import AXES, FARTHEST, RANGE_UNIT_M
from hbbatch.motion.turns import turn


class KalmanFilter(nn.Module):
    """Rows: velocity (and acceleration) in the world frame, covariances, heading vote, class."""

    def __init__(self, class_names: tuple[str, ...], model: MotionModel = "cv") -> None:
        """Make a filter with unfitted, plausible noise."""
        super().__init__()
        self.class_names = class_names
        self.model: MotionModel = model
        self.order = kalman_order(model)
        self.columns = kalman_columns(model)
        self.width = self.columns.width
        classes = len(class_names)
        start = torch.tensor([-2.5, -3.5, -5.0, -4.0])
        self.log_r = nn.Parameter(start.repeat(classes, 1))
        self.log_r_range = nn.Parameter(torch.zeros(classes, AXES))
        self.log_q = nn.Parameter(torch.tensor([0.0, -1.5, -4.0, -4.0]).repeat(classes, 1))
        derivatives = torch.tensor([[4.0, 0.0, -3.0, -2.0], [0.0, -1.0, -4.0, -4.0]])
        self.log_initial = nn.Parameter(derivatives[: self.order - 1].repeat(classes, 1, 1))
        self.log_r_size = nn.Parameter(torch.full((classes, 3), -4.0))
        self.log_q_size = nn.Parameter(torch.full((classes, 3), -9.0))

    def birth(self, measurement: Measurement, class_code: Tensor) -> Tensor:
        """Rows `(n, width)` of tracks born from detections, at rest with wide uncertainty."""
        variance, size_variance = self.measurement_variance(measurement, class_code)
        variances = self.log_initial[class_code].exp()
        derivatives = [variances[:, d] for d in range(self.order - 1)]
        at_rest = torch.zeros_like(variances).flatten(1)
        vote = torch.ones_like(size_variance[:, :1])
        code = class_code[:, None].to(vote.dtype)
        covariance = join(initial([variance, *derivatives]))
        return torch.cat([at_rest, covariance, size_variance, vote, code], dim=1)

    def measurement_variance(self, seen: Measurement, class_code: Tensor) -> tuple[Tensor, Tensor]:
        """Variance of measured motion `(n, 4)` and sizes `(n, 3)`, growing with range."""
        far = (plan_range(seen.sight_m) / RANGE_UNIT_M).clamp(max=FARTHEST)
        motion = (self.log_r[class_code] + self.log_r_range[class_code] * far).exp()
        return motion, self.log_r_size[class_code].exp()

    def predict(self, boxes: Tensor, rows: Tensor, dt_s: Tensor) -> tuple[Tensor, Tensor]:
        """Prior boxes and rows `dt_s` seconds later."""
        code = rows[:, -1].long()
        return self.predict_with(boxes, rows, dt_s, self.log_q[code].exp())

    def predict_with(
        self, boxes: Tensor, rows: Tensor, dt_s: Tensor, noise: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Prior boxes and rows with the process noise `(n, 4)` given."""
        dt = dt_s[:, None]
        column = self.columns
        step, velocity = self._advance(rows, dt)
        yaw = step[:, 3:4]
        box_step = torch.cat([step[:, :3], torch.zeros_like(step[:, :3]), yaw], dim=1)
        covariance = blocks(rows[:, column["covariance"]], self.order, AXES)
        covariance = cov.propagate(covariance, noise, dt)
        size_noise = self.log_q_size[rows[:, -1].long()].exp() * dt
        size_variance = rows[:, column["size_variance"]] + size_noise
        tail = rows[:, column["heading_vote"].start :]
        return boxes + box_step, torch.cat([velocity, join(covariance), size_variance, tail], dim=1)

    def _advance(self, rows: Tensor, dt: Tensor) -> tuple[Tensor, Tensor]:
        """World-frame step `(n, 4)` and the derivatives after it, by the motion model."""
        velocity = rows[:, self.columns["velocity"]]
        if self.model == "cv":
            return velocity * dt, velocity
        if self.model == "ca":
            acceleration = rows[:, self.columns["acceleration"]]
            after = velocity + acceleration * dt
            return (velocity + after) * (0.5 * dt), torch.cat([after, acceleration], dim=1)
        return _coordinated_turn(velocity, dt)

    def update(self, prior: Tensor, rows: Tensor, seen: Measurement) -> tuple[Tensor, Tensor]:
        """Posterior boxes and rows after a matched detection."""
        variance = self.measurement_variance(seen, rows[:, -1].long())
        return self.update_with(prior, rows, innovation(prior, seen.boxes), *variance)

    def update_with(
        self,
        prior: Tensor,
        rows: Tensor,
        new: Innovation,
        variance: Tensor,
        size_variance: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Posterior boxes and rows with the innovation and the measurement variances given."""
        column = self.columns
        covariance = blocks(rows[:, column["covariance"]], self.order, AXES)
        gains, covariance = cov.correct(covariance, variance)
        before = rows[:, column["size_variance"]]
        size_gain = before / (before + size_variance)
        boxes = moved(prior, gains[0] * new.motion, size_gain * new.size, new.cos, new.sin)
        vote = rows[:, column["heading_vote"]]
        boxes, vote = settle_heading(boxes, vote, new.flipped)
        derivatives = torch.cat(
            [
                rows[:, AXES * d : AXES * (d + 1)] + _to_world(gain * new.motion, new.cos, new.sin)
                for d, gain in enumerate(gains[1:])
            ],
            dim=1,
        )
        shrunk = (1.0 - size_gain) * before
        return boxes, torch.cat([derivatives, join(covariance), shrunk, vote, rows[:, -1:]], dim=1)

    def velocity(self, rows: Tensor) -> Tensor:
        """`(n, 3)` velocity in the world frame, m/s."""
        return rows[:, self.columns["velocity"]][:, :3]


def _to_world(local: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    x, y = turn(local[:, 0:1], local[:, 1:2], cos, sin)
    return torch.cat([x, y, local[:, 2:]], dim=1)


def _coordinated_turn(velocity: Tensor, dt: Tensor) -> tuple[Tensor, Tensor]:
    """Step and velocity when the velocity vector turns with the yaw rate (chord at half turn)."""
    half = velocity[:, 3:4] * (0.5 * dt)
    cos, sin = torch.cos(half), torch.sin(half)
    mid_x, mid_y = turn(velocity[:, 0:1], velocity[:, 1:2], cos, sin)
    end_x, end_y = turn(mid_x, mid_y, cos, sin)
    rest = velocity[:, 2:]
    step = torch.cat([mid_x, mid_y, rest], dim=1) * dt
    return step, torch.cat([end_x, end_y, rest], dim=1)
