"""How packed filters hold boxes, and what the kernels are given."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray

Single = NDArray[np.float32]
IntArray = NDArray[np.int64]

PACKED: Final = np.array([3, 4, 5, 0, 1, 2, 6])
"""Packed boxes are rows length, width, height, x, y, z, yaw, so that the four axes with motion lie
together. The permutation is its own inverse: it leads there from a box's columns, and back."""

NONE: Final = np.empty((0, 8), np.float32)
NOTHING: Final = np.empty(0, np.float32)
"""For layers and limits, which the learned filter has and the classical one has not."""


class FilterArrays(NamedTuple):
    """A packed filter (`c/filter.h`).

    Attributes:
        layout: of the state, `packed.layout`.
        newborn: `(height, kinds)` a track of each kind before its detection is looked at.
        residual_limit, encoder, heads_in, heads_out: `network.residual_layers`.
        gain_limit, gates, kept, candidate, read_out: `network.gain_layers`.
    """

    layout: IntArray
    newborn: Single
    residual_limit: Single
    encoder: Single
    heads_in: Single
    heads_out: Single
    gain_limit: Single
    gates: Single
    kept: Single
    candidate: Single
    read_out: Single


class KnownArrays(NamedTuple):
    """What is known of a group beforehand: n detections, sorted by step.

    Attributes:
        offsets: `(steps + 1,)` first detection of each step.
        first_frame: `(sequences,)` column of `times` for a sequence in step 0.
        sequence: `(n,)` number of each one's sequence.
        place: `(n,)` where what is said of it goes, and who a track is that it begins.
        block: `(n,)`; tracks match detections of their own block only.
        kinds: `(n,)` kind codes.
        measured: `(n, 7)` boxes, not packed.
        seen: `(n, DETECTION.width)` see `packed.kalman`.
        times: `(rows, frames)` see `PackedKalman.times`.
    """

    offsets: IntArray
    first_frame: IntArray
    sequence: IntArray
    place: IntArray
    block: IntArray
    kinds: IntArray
    measured: FloatArray
    seen: Single
    times: Single


class TrackArrays(NamedTuple):
    """Tracks, a column each in matrices of so many columns that some are spare.

    Attributes:
        cells: `(6, columns)` the table of `tracking.rows`.
        boxes: `(7, columns)` packed.
        state: `(height, columns)`.
    """

    cells: IntArray
    boxes: FloatArray
    state: Single


class SaidArrays(NamedTuple):
    """What is said of tracks, a place each: those of the detections, then those of coasting tracks.

    Attributes:
        first: `(places,)` the place of the detection that the track was born from.
        step: `(places,)`.
        boxes: `(places, 7)` not packed.
        velocity_m_s: `(places, 3)`.
    """

    first: IntArray
    step: IntArray
    boxes: FloatArray
    velocity_m_s: FloatArray


class StepArrays(NamedTuple):
    """What is left of a step behind.

    Attributes:
        priors: room for prior boxes of all columns; of n tracks, the first 7 n are `(7, n)`.
        rows: `(columns,)` of matched pairs.
        numbers: `(columns,)` detections of the same.
        counts: tracks alive, places used, track steps predicted and corrected so far.
        seconds: to predict, associate, update and manage so far.
    """

    priors: FloatArray
    rows: IntArray
    numbers: IntArray
    counts: IntArray
    seconds: FloatArray
