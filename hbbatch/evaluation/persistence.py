"""Score cuts found without labels: true objects persist, false detections do not.

Detectors' scores have no common scale. What they share is that a detection of a true object is
followed by others in most of the next frames. The share of detections that belong to long, dense
tracks rises with the score; where it passes a level is a cut that means the same for every
detector.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray

TRACK_LEVEL: Final = 0.7
LOCAL_LEVEL: Final = 0.4
"""Persistence at the cut on a track's mean score, and on its mean score nearby: the best on average
over three detectors on the KITTI training sequences (docs/accuracy.md)."""

_LONG_DETECTIONS: Final = 10
_DENSE: Final = 0.8
_BINS: Final = 30
_FEWEST_DETECTIONS: Final = 300


class ScoreCuts(NamedTuple):
    """Lowest scores to write; None where everything persists."""

    track: float | None
    local: float | None
    detections: int


def score_cuts(tables: Iterable[pa.Table], class_name: str) -> ScoreCuts | None:
    """Cuts for a class from uncut tracks (`schema.TRACKS`); None when there are too few to tell."""
    parts = [_persistence(table, class_name) for table in tables]
    score = np.concatenate([part[0] for part in parts])
    persists = np.concatenate([part[1] for part in parts])
    if len(score) < _FEWEST_DETECTIONS:
        return None
    curve = _rising_curve(score, persists)
    return ScoreCuts(_crossing(*curve, TRACK_LEVEL), _crossing(*curve, LOCAL_LEVEL), len(score))


def _persistence(table: pa.Table, class_name: str) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Score of each detection, and whether its track is long and dense."""
    table = table.filter(pc.equal(table["class_name"], class_name))
    _, track = np.unique(table["track_id"].to_numpy(), return_inverse=True)
    score = table["score"].to_numpy()
    seen = ~np.isnan(score)
    frame = table["frame_index"].to_numpy()
    count = np.bincount(track, seen)
    first, last = np.full(len(count), np.inf), np.full(len(count), -np.inf)
    np.minimum.at(first, track, frame)
    np.maximum.at(last, track, frame)
    long = (count >= _LONG_DETECTIONS) & (count > _DENSE * (last - first + 1))
    return score[seen], long[track][seen]


def _rising_curve(score: FloatArray, persists: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Median score of bins of equal count, and how persistent their detections are.

    Made monotonic, and relative to the most persistent bin: even true pedestrians are missed more
    often than cars.
    """
    bins = np.array_split(np.argsort(score, kind="stable"), _BINS)
    share = np.maximum.accumulate(np.array([persists[rows].mean() for rows in bins]))
    return np.array([np.median(score[rows]) for rows in bins]), share / max(share[-1], 1e-9)


def _crossing(score: FloatArray, share: FloatArray, level: float) -> float | None:
    return None if share[0] >= level else float(np.interp(level, share, score))
