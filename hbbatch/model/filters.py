"""What every motion filter offers the tracker and the training loop, and what filters share.

A filter keeps, for n tracks, boxes `(n, 7)` float64 (posterior, world frame) and rows
`(n, width)` float32 (everything else it remembers). It never sees absolute positions in float32:
differences are taken in float64 first, then turned into the track's heading frame, so results do
not depend on where in the world a drive took place.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from hbbatch.model.geometry import wrap_angle, wrap_half_turn
from hbbatch.motion.constants import MAX_HEADING_VOTE, SMALLEST_SIZE_M
from hbbatch.motion.turns import turn


class Measurement(NamedTuple):
    """Detections matched to tracks.

    Attributes:
        boxes: `(n, 7)` float64, world frame.
        sight_m: `(n, 3)` float32 from the sensor to the box centre, world axes.
        score: `(n,)` float32 as logged.
    """

    boxes: Tensor
    sight_m: Tensor
    score: Tensor


class MotionFilter(Protocol):
    """A filter's three steps on rows; all tensors of one call share a device."""

    class_names: tuple[str, ...]
    width: int

    def birth(self, measurement: Measurement, class_code: Tensor) -> Tensor:
        """Rows `(n, width)` of tracks born from detections."""
        ...

    def predict(self, boxes: Tensor, rows: Tensor, dt_s: Tensor) -> tuple[Tensor, Tensor]:
        """Prior boxes and rows `dt_s` `(n,)` seconds later."""
        ...

    def update(self, prior: Tensor, rows: Tensor, seen: Measurement) -> tuple[Tensor, Tensor]:
        """Posterior boxes and rows after a matched detection."""
        ...

    def velocity(self, rows: Tensor) -> Tensor:
        """`(n, 3)` float32 velocity in the world frame, m/s."""
        ...


class Innovation(NamedTuple):
    """Measurement minus prior, in the heading frame of the prior, float32.

    Attributes:
        motion: `(n, 4)` along, across, up, yaw; yaw as if a half turn did not matter.
        size: `(n, 3)` length, width, height.
        flipped: `(n,)` bool, the measured heading points the other way.
        cos, sin: `(n, 1)` of the prior's yaw.
    """

    motion: Tensor
    size: Tensor
    flipped: Tensor
    cos: Tensor
    sin: Tensor


def innovation(prior: Tensor, measured: Tensor) -> Innovation:
    """Measured boxes minus prior boxes, both `(n, 7)` float64."""
    difference = measured - prior
    yaw = wrap_half_turn(difference[:, 6:7])
    turned_away = wrap_angle(difference[:, 6]).abs() > torch.pi / 2
    local = difference.float()
    heading = prior[:, 6:7].float()
    cos, sin = torch.cos(heading), torch.sin(heading)
    along, across = turn(local[:, 0:1], local[:, 1:2], cos, -sin)
    motion = torch.cat([along, across, local[:, 2:3], yaw.float()], dim=1)
    return Innovation(motion, local[:, 3:6], turned_away, cos, sin)


def plan_range(sight_m: Tensor) -> Tensor:
    """Horizontal distance `(n, 1)` from the sensor, at least a metre."""
    return sight_m[:, :2].square().sum(dim=1, keepdim=True).sqrt().clamp(min=1.0)


def moved(boxes: Tensor, motion: Tensor, size: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Boxes `(n, 7)` float64 moved by a heading-frame step.

    Args:
        boxes: where to start.
        motion: `(n, 4)` float32 along, across, up, yaw.
        size: `(n, 3)` float32 change of length, width, height.
        cos: `(n, 1)` cosine of the heading the step is expressed in.
        sin: `(n, 1)` its sine.
    """
    x, y = turn(motion[:, 0:1], motion[:, 1:2], cos, sin)
    sizes = (boxes[:, 3:6] + size).clamp(min=SMALLEST_SIZE_M)
    centre = boxes[:, :3] + torch.cat([x, y, motion[:, 2:3]], dim=1)
    return torch.cat([centre, sizes, boxes[:, 6:7] + motion[:, 3:4]], dim=1)


def settle_heading(boxes: Tensor, vote: Tensor, flipped: Tensor) -> tuple[Tensor, Tensor]:
    """Count a detection's say on which end is the front, and turn tracks that lost the vote.

    A single flipped detection never turns a track; a track born flipped turns once more
    detections contradict it than support it.

    Args:
        boxes: `(n, 7)` posterior boxes, already corrected for yaw modulo a half turn.
        vote: `(n, 1)` support for the present heading.
        flipped: `(n,)` bool.

    Returns:
        Boxes with yaw in [-π, π) and the new votes.
    """
    vote = (vote + torch.where(flipped[:, None], -1.0, 1.0)).clamp(max=MAX_HEADING_VOTE)
    lost = vote < 0
    yaw = wrap_angle(boxes[:, 6:7] + torch.where(lost, torch.pi, 0.0))
    return torch.cat([boxes[:, :6], yaw], dim=1), vote.abs()
