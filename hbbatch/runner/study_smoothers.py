"""Posteriors on dense tracks next to what fitted smoothers of the same detections get."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from hbbatch.errors import DatasetError
from hbbatch.model.filters import MotionFilter
from hbbatch.model.horizon import FilterError
from hbbatch.model.kinds import KINDS
from hbbatch.model.smoothers import (
    CAUSAL,
    SIDE_FRAMES,
    TWO_SIDED,
    dense_windows,
    fit_smoother,
    middle_error,
    middle_posterior,
    smoothed,
)
from hbbatch.model.windows import Windows
from hbbatch.runner.labelled import LabelledSequences

_VEHICLE = KINDS.index("vehicle")
_FRAMES = 2 * SIDE_FRAMES + 1

SMOOTHERS: Final = {"fitted causal smoother": CAUSAL, "fitted two-sided smoother": TWO_SIDED}

DenseWindows = dict[str, Windows]
"""Of the vehicles of each dataset that has any which are detected frame by frame."""

Errors = dict[str, FilterError]
"""By dataset."""


def dense_by_name(sequences: Mapping[str, LabelledSequences]) -> DenseWindows:
    """What posteriors and smoothers are judged on, by dataset."""
    dense = {}
    for name, of_dataset in sequences.items():
        try:
            data = of_dataset.windows("detections", _FRAMES)
        except DatasetError:  # nothing that lasts
            continue
        windows = dense_windows(data, _VEHICLE)
        if len(windows.kind_code):
            dense[name] = windows
    return dense


def posterior_errors(motion: MotionFilter, judged: DenseWindows) -> Errors:
    """Of a filter's posteriors."""
    return {
        name: middle_error(middle_posterior(motion, windows), windows)
        for name, windows in judged.items()
    }


def smoother_errors(known: DenseWindows, judged: DenseWindows) -> dict[str, Errors]:
    """Of the detections themselves, and of smoothers fitted to each dataset.

    Args:
        known: what smoothers are fitted to.
        judged: of other sequences.
    """
    detected = {
        name: middle_error(windows.measured[:, SIDE_FRAMES], windows)
        for name, windows in judged.items()
    }
    return {
        "detections": detected,
        **{
            title: {
                name: middle_error(smoothed(windows, fit_smoother(known[name], frames)), windows)
                for name, windows in judged.items()
                if name in known
            }
            for title, frames in SMOOTHERS.items()
        },
    }
