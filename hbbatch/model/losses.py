"""What a filter is trained to make small (paper, section III-F)."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

from hbbatch.model.filters import innovation

COORDINATE_WEIGHTS: Final = (0.5, 1.0, 1.5, 1.0, 0.5, 1.0, 1.5)
"""Along, across, up (m), yaw (rad), length, width, height (m): what an image shows counts more."""

_SAME_PLACE_M: Final = 1e-3


def box_error(boxes: Tensor, truth: Tensor) -> Tensor:
    """Absolute error `(n, 7)` float32: along, across, up, yaw modulo a half turn, sizes.

    Taken in the heading frame of the truth, so that it does not depend on the world's axes.
    """
    difference = innovation(truth, boxes)
    return torch.cat([difference.motion, difference.size], dim=1).abs()


def state_loss(boxes: Tensor, truth: Tensor, weights: Tensor) -> Tensor:
    """Weighted L1 error of each box, `(n,)` (L_states)."""
    return box_error(boxes, truth) @ weights


def temporal_loss(step_m: Tensor) -> Tensor:
    """L1 length of a centre's step `(n, 3)`, `(n,)` (L_temporal). It rewards standing still."""
    return step_m.abs().sum(dim=1)


def direction_loss(step_m: Tensor, previous_step_m: Tensor) -> Tensor:
    """Change of the direction of motion between two steps, `(n,)` (L_direction)."""
    change: Tensor = torch.linalg.vector_norm(
        _direction(step_m) - _direction(previous_step_m), dim=1
    )
    return change


def _direction(step_m: Tensor) -> Tensor:
    # The floor keeps the gradient finite for objects at rest.
    return step_m / (step_m.square().sum(dim=1, keepdim=True) + _SAME_PLACE_M**2).sqrt()
