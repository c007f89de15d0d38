"""Training of the learned filter, end to end over prediction and update (paper, section III-F)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from hbbatch.model.calibration import BURN_IN_FRAMES, CovarianceFilter, variances
from hbbatch.model.filters import innovation
from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.likelihood import student_t
from hbbatch.model.losses import (
    COORDINATE_WEIGHTS,
    direction_loss,
    state_loss,
    temporal_loss,
)
from hbbatch.model.train_settings import TrainSettings
from hbbatch.model.unroll import Step, unroll
from hbbatch.model.windows import Windows, WindowSet

Progress = Callable[[int, float], None]

_WORST_LOSS = 5.0
"""Cap on the loss of one box, so that a wrongly matched detection does not rule a batch."""

_LONGEST_GRADIENT = 1.0


class LossParts(NamedTuple):
    """Means over the valid boxes of a batch, each a scalar."""

    prior: Tensor
    posterior: Tensor
    temporal: Tensor
    direction: Tensor
    likelihood: Tensor


def train_hybrid(
    motion: HybridFilter, data: WindowSet, settings: TrainSettings, progress: Progress
) -> list[float]:
    """Train the learned parts in place; the classical base stays as its likelihood fit left it.

    Args:
        motion: the filter; its classical base should be fitted already.
        data: training windows.
        settings: how long, how fast, which losses.
        progress: called with the iteration and its loss.

    Returns:
        The loss of every iteration.
    """
    generator = torch.Generator().manual_seed(settings.seed)
    learned = learned_parameters(motion, settings.learn)
    optimiser = torch.optim.Adam(
        learned, lr=settings.learning_rate, weight_decay=settings.weight_decay
    )
    rates = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, settings.learning_rate, total_steps=settings.iterations, pct_start=0.05
    )
    history = []
    for iteration in range(settings.iterations):
        chosen = data.draw(settings.batch, generator)
        stride = strides(data.frames_left[chosen], settings, generator)
        windows = augment(data.cut(chosen, settings.frames, stride), settings, generator)
        loss = total_loss(batch_losses(motion, windows), settings)
        optimiser.zero_grad()
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(learned, _LONGEST_GRADIENT)
        optimiser.step()
        rates.step()
        history.append(loss.item())
        progress(iteration, history[-1])
    return history


def learned_parameters(
    motion: HybridFilter, part: Literal["both", "prediction", "update"]
) -> list[nn.Parameter]:
    """What is trained. A part that is left out keeps its read-out at zero, and so says nothing.

    The prediction needs the recurrent memory, so that is trained with either part.
    """
    residual, gain = list(motion.residual.parameters()), motion.gain
    if part == "update":
        return list(gain.parameters())
    if part == "prediction":
        return [*residual, *gain.recurrent.parameters()]
    return [*residual, *gain.parameters()]


def total_loss(parts: LossParts, settings: TrainSettings) -> Tensor:
    """L = λ₁·L_states + λ₂·L_temporal + λ₃·L_direction, and the likelihood's share."""
    return (
        settings.state_weight * (parts.prior + parts.posterior)
        + settings.temporal_weight * parts.temporal
        + settings.direction_weight * parts.direction
        + settings.likelihood_weight * parts.likelihood
    )


def batch_losses(motion: CovarianceFilter, windows: Windows) -> LossParts:
    """The losses of a batch, unrolled from birth."""
    weights = torch.tensor(COORDINATE_WEIGHTS)
    prior = posterior = temporal = direction = likelihood = torch.zeros(())
    before = windows.measured[:, 0, :3]
    previous_step = torch.zeros_like(before).float()
    for step in unroll(motion, windows):
        valid = windows.valid[:, step.frame]
        truth = windows.truth[:, step.frame]
        centre_step = (step.posterior[:, :3] - before).float()
        prior = prior + _capped(state_loss(step.prior, truth, weights), valid)
        posterior = posterior + _capped(state_loss(step.posterior, truth, weights), valid)
        if step.frame > BURN_IN_FRAMES:
            surprise = _surprise(motion, step, truth)
            likelihood = likelihood + torch.where(valid, surprise, 0.0).sum()
        temporal = temporal + _capped(temporal_loss(centre_step), valid)
        if step.frame > 1:
            direction = direction + _capped(direction_loss(centre_step, previous_step), valid)
        before, previous_step = step.posterior[:, :3], centre_step
    count = windows.valid[:, 1:].sum().clamp(min=1)
    sums = LossParts(prior, posterior, temporal, direction, likelihood)
    return LossParts(*(total / count for total in sums))


def _surprise(motion: CovarianceFilter, step: Step, truth: Tensor) -> Tensor:
    """Negative log likelihood `(b,)` of the truth under the covariance of a step's posterior."""
    error = innovation(truth, step.posterior).motion
    return student_t(error, variances(motion, step.rows))


def _capped(loss: Tensor, valid: Tensor) -> Tensor:
    return torch.where(valid, loss.clamp(max=_WORST_LOSS), 0.0).sum()


def strides(frames_left: Tensor, settings: TrainSettings, generator: torch.Generator) -> Tensor:
    """Every how manieth frame is kept of each window, so that slower sensors are learned as well.

    No window is left with fewer than `min_frames` frames.

    Args:
        frames_left: `(b,)` frames that there are.
        settings: how often and how far windows are thinned out.
        generator: source of chance.
    """
    count = len(frames_left)
    if not settings.thinned_probability:
        return torch.ones_like(frames_left)
    thinned = torch.rand(count, generator=generator) < settings.thinned_probability
    longest = torch.clamp(frames_left // settings.min_frames, 1, settings.longest_stride)
    drawn = 1 + (torch.rand(count, generator=generator) * longest).long()
    return torch.where(thinned, drawn, 1)


def augment(windows: Windows, settings: TrainSettings, generator: torch.Generator) -> Windows:
    """Bursts of missed detections and left-right mirror images.

    Turning the scene changes nothing: filters work in each track's own heading frame.
    """
    batch, frames = windows.seen.shape
    first = torch.randint(1, frames, (batch, 1), generator=generator)
    length = torch.randint(1, settings.longest_burst + 1, (batch, 1), generator=generator)
    missing = torch.rand(batch, 1, generator=generator) < settings.burst_probability
    frame = torch.arange(frames)
    burst = missing & (frame >= first) & (frame < first + length)
    side = torch.where(torch.rand(batch, 1, generator=generator) < 0.5, -1.0, 1.0).double()
    return windows._replace(
        seen=windows.seen & ~burst,
        truth=_mirrored(windows.truth, side),
        measured=_mirrored(windows.measured, side),
        sight_m=_mirrored(windows.sight_m, side.float()),
    )


def _mirrored(boxes: Tensor, side: Tensor) -> Tensor:
    return torch.stack(
        [column * side if i in (1, 6) else column for i, column in enumerate(boxes.unbind(-1))], -1
    )
