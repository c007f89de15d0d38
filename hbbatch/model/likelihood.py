"""Noise of the classical filter, fitted by the likelihood of its innovations.

The innovation form of the likelihood (Schweppe 1965): every measurement is judged by the filter's
own forecast of it, so process and measurement noise are told apart without any label.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from hbbatch.model.blocks import blocks
from hbbatch.model.filters import innovation
from hbbatch.model.kalman import KalmanFilter
from hbbatch.model.unroll import Step, unroll
from hbbatch.model.windows import Windows, WindowSet
from hbbatch.motion.constants import AXES

TAIL = 5.0
"""Degrees of freedom of the Student t that judges innovations, so that outliers do not rule."""


def fit_noise(
    motion: KalmanFilter,
    data: WindowSet,
    *,
    iterations: int,
    batch: int,
    frames: int,
    seed: int,
    progress: Callable[[int, float], None],
) -> list[float]:
    """Fit all noise parameters in place.

    Returns:
        Mean negative log likelihood a measurement, an entry an iteration.
    """
    generator = torch.Generator().manual_seed(seed)
    optimiser = torch.optim.Adam(motion.parameters(), lr=0.05)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations, eta_min=2e-3)
    history = []
    for iteration in range(iterations):
        windows = data.cut(data.draw(batch, generator), frames)
        loss = negative_log_likelihood(motion, windows)
        optimiser.zero_grad()
        torch.autograd.backward(loss)
        optimiser.step()
        schedule.step()
        history.append(loss.item())
        progress(iteration, history[-1])
    return history


def negative_log_likelihood(motion: KalmanFilter, windows: Windows) -> Tensor:
    """Mean over all detections after the first."""
    total = torch.zeros(())
    for step in unroll(motion, windows):
        seen = windows.seen[:, step.frame]
        total = total + torch.where(seen, _judge(motion, windows, step), 0.0).sum()
    return total / windows.seen[:, 1:].sum().clamp(min=1)


def _judge(motion: KalmanFilter, windows: Windows, step: Step) -> Tensor:
    """Negative log likelihood `(b,)` of each measurement of a frame."""
    seen = windows.measurement(step.frame)
    variance, size_variance = motion.measurement_variance(seen, windows.kind_code)
    column = motion.columns
    forecast = blocks(step.predicted[:, column["covariance"]], motion.order, AXES)[0, 0]
    new = innovation(step.prior, seen.boxes)
    size_forecast = step.predicted[:, column["size_variance"]]
    return student_t(new.motion, forecast + variance) + student_t(
        new.size, size_forecast + size_variance
    )


def student_t(difference: Tensor, variance: Tensor) -> Tensor:
    """Negative log likelihood of a Student t of that variance, summed over columns, `(n,)`."""
    scale = variance * ((TAIL - 2.0) / TAIL)
    constant = math.lgamma(TAIL / 2) - math.lgamma((TAIL + 1) / 2) + 0.5 * math.log(TAIL * math.pi)
    tail = 0.5 * (TAIL + 1.0) * torch.log1p(difference**2 / (TAIL * scale))
    return (tail + 0.5 * torch.log(scale) + constant).sum(dim=1)
