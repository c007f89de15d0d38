"""Training windows: stretches of trajectories as tensors, cut out on the fly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from hbbatch.model.filters import Measurement

_PADDED_DT_S = 0.1
"""Time step of frames after an object's end: they are not counted, but filters divide by it."""


class Windows(NamedTuple):
    """A batch of b windows of t frames; frame 0 is a detection, from which the track is born.

    Attributes:
        truth: `(b, t, 7)` float64, world frame.
        measured: `(b, t, 7)` float64.
        seen: `(b, t)` bool, a detection is there.
        valid: `(b, t)` bool, the object still exists.
        sight_m: `(b, t, 3)` float32, from the sensor to the detection, world axes.
        score: `(b, t)` float32.
        dt_s: `(b, t)` float32.
        kind_code: `(b,)` int64.
    """

    truth: Tensor
    measured: Tensor
    seen: Tensor
    valid: Tensor
    sight_m: Tensor
    score: Tensor
    dt_s: Tensor
    kind_code: Tensor

    def measurement(self, frame: int) -> Measurement:
        """The detections of one frame."""
        return Measurement(self.measured[:, frame], self.sight_m[:, frame], self.score[:, frame])


@dataclass(frozen=True)
class WindowSet:
    """All windows that can be cut from trajectories.

    Attributes:
        columns: tensors of `Trajectories`, a row an object and frame.
        start: `(windows,)` first row of each window, a seen one.
        frames_left: `(windows,)` rows of the object from there on.
        kind_code: `(windows,)`.
    """

    columns: Mapping[str, Tensor]
    start: Tensor
    frames_left: Tensor
    kind_code: Tensor

    def __len__(self) -> int:
        return len(self.start)

    @cached_property
    def time_s(self) -> Tensor:
        """Time of every row; only differences within an object mean anything."""
        return self.columns["dt_s"].double().cumsum(0)

    def draw(self, count: int, generator: torch.Generator) -> Tensor:
        """Random windows; rare kinds are drawn more often than their share (square root)."""
        frequency = torch.bincount(self.kind_code).double()
        weights = frequency.clamp(min=1).rsqrt()[self.kind_code]
        return torch.multinomial(weights, count, replacement=True, generator=generator)

    def cut(self, windows: Tensor, frames: int, stride: Tensor | int = 1) -> Windows:
        """The chosen windows, `frames` long; frames after an object's end are not valid.

        Args:
            windows: `(b,)` which.
            frames: how many frames of each are kept.
            stride: every how manieth frame is kept, `(b,)` or the same for all; the others are as
                if the sensor had been slower.
        """
        steps = torch.as_tensor(stride).reshape(-1, 1)
        offset = torch.arange(frames) * steps
        valid = offset < self.frames_left[windows, None]
        rows = self.start[windows, None] + torch.where(valid, offset, 0)
        column = self.columns
        dt_s = torch.diff(self.time_s[rows], dim=1, prepend=self.time_s[rows[:, :1]])
        return Windows(
            column["truth"][rows],
            column["measured"][rows],
            column["seen"][rows] & valid,
            valid,
            column["sight_m"][rows].float(),
            column["score"][rows].float(),
            torch.where(valid, dt_s, _PADDED_DT_S).float(),
            self.kind_code[windows],
        )

    def select(self, windows: Tensor) -> WindowSet:
        """A subset of the windows on the same trajectories."""
        return WindowSet(
            self.columns, self.start[windows], self.frames_left[windows], self.kind_code[windows]
        )


def window_set(
    columns: Mapping[str, Tensor],
    first_row: Tensor,
    length: Tensor,
    kind_code: Tensor,
    min_frames: int,
) -> WindowSet:
    """Every window that starts at a detection and has at least `min_frames` frames."""
    objects = torch.repeat_interleave(torch.arange(len(first_row)), length)
    row = torch.arange(len(objects))
    left = first_row[objects] + length[objects] - row
    start = torch.nonzero(columns["seen"] & (left >= min_frames)).flatten()
    return WindowSet(columns, start, left[start], kind_code[objects[start]])
