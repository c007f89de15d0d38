"""The two learned parts: what the motion model misses, and how much to trust a detection.

Sizes are small on purpose: a step of one track is some ten thousand multiply-adds.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from hbbatch.motion.constants import AXES, HEADS, LARGEST_SAID, RESIDUAL_UNIT


class ResidualPredictor(nn.Module):
    """What the motion model misses: an encoder, then a head each for centre and yaw.

    Paper, section III-B; its third head, for the sizes, is left out (`motion.constants.HEADS`).

    The last layers start at zero, so an untrained network leaves the motion model as it is.
    """

    unit: Tensor

    def __init__(self, features: int, hidden: int, head: int) -> None:
        """Encoder to `hidden`, each head through `head` units."""
        super().__init__()
        self.encoder = nn.Linear(features, hidden)
        self.heads_in = nn.Linear(hidden, head * len(HEADS))
        self.heads_out = nn.ModuleDict(
            {name: nn.Linear(head, len(axes)) for name, axes in HEADS.items()}
        )
        for layer in self.heads_out.values():
            _start_at_zero(layer)
        unit = torch.tensor(list(RESIDUAL_UNIT.values()))
        self.register_buffer("unit", unit, persistent=False)

    def forward(self, features: Tensor) -> Tensor:
        """Rates `(n, 3)`: m/s along and across, rad/s of yaw."""
        encoded = torch.relu(self.heads_in(torch.relu(self.encoder(features))))
        parts = encoded.chunk(len(HEADS), dim=1)
        heads = zip(self.heads_out.values(), parts, strict=True)
        return torch.cat([layer(part) for layer, part in heads], dim=1) * self.unit


class Trust(NamedTuple):
    """What the recurrent part makes of a detection.

    Attributes:
        memory: `(n, memory)` new recurrent state.
        process, measured: log factors of the process and measurement noise of the motion axes,
            `(n, 4)` each. Sizes are left to the classical filter, whose estimates generalise
            better from one detector to the next.
    """

    memory: Tensor
    process: Tensor
    measured: Tensor


class GainNetwork(nn.Module):
    """The recurrent part (paper, section III-D): noises that set the Kalman gain.

    KalmanNet's (Revach et al. 2022) roles of process noise, prior covariance and innovation
    covariance: the covariances themselves are carried in closed form, and one recurrent state
    scales the process noise of the next step and the measurement noise of this one.
    """

    def __init__(self, features: int, memory: int) -> None:
        """A gated recurrent unit of `memory` units and a linear read-out."""
        super().__init__()
        self.recurrent = nn.GRUCell(features, memory)
        self.read_out = nn.Linear(memory, 2 * AXES)
        _start_at_zero(self.read_out)

    def forward(self, features: Tensor, memory: Tensor) -> Trust:
        """What to make of a detection, from features `(n, features)` and memory `(n, memory)`."""
        memory = self.recurrent(features, memory)
        said = LARGEST_SAID * torch.tanh(self.read_out(memory) / LARGEST_SAID)
        return Trust(memory, said[:, :AXES], said[:, AXES:])


def _start_at_zero(layer: nn.Module) -> None:
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)
