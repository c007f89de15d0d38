"""A filter run over training windows, from birth to the last frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from hbbatch.model.filters import MotionFilter
from hbbatch.model.windows import Windows


class Step(NamedTuple):
    """One frame of an unrolled batch.

    Attributes:
        frame: its number in the window, from 1.
        prior: `(b, 7)` float64.
        predicted: `(b, width)` rows after the prediction.
        posterior: `(b, 7)` float64; the prior where nothing was detected.
        rows: `(b, width)` rows after the update.
    """

    frame: int
    prior: Tensor
    predicted: Tensor
    posterior: Tensor
    rows: Tensor


def unroll(motion: MotionFilter, windows: Windows) -> Iterator[Step]:
    """Birth at frame 0, then predict and update frame by frame."""
    boxes = windows.measured[:, 0]
    rows = motion.birth(windows.measurement(0), windows.kind_code)
    for frame in range(1, windows.truth.shape[1]):
        prior, predicted = motion.predict(boxes, rows, windows.dt_s[:, frame])
        corrected, updated = motion.update(prior, predicted, windows.measurement(frame))
        seen = windows.seen[:, frame, None]
        boxes = torch.where(seen, corrected, prior)
        rows = torch.where(seen, updated, predicted)
        yield Step(frame, prior, predicted, boxes, rows)
