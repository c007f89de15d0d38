"""Compiled from `c/`; every function refuses arrays that do not fit with ValueError.

Arrays are contiguous. Matrices of tracks may have more columns than there are tracks; `layout` is
from `packed.layout`, and what else filters are given from `packed.kalman`, which see.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.packed.arrays import IntArray, Single

def match(
    priors: FloatArray,
    track_block: IntArray,
    boxes: FloatArray,
    block: IntArray,
    rows: IntArray,
    numbers: IntArray,
    start: int,
    stop: int,
    stretch: float,
    threshold: float,
    /,
) -> int:
    """`tracking.association.match` with the cost ciou_3d; how many pairs there are.

    Args:
        priors: `(7, n)`.
        track_block: `(n,)`.
        boxes: `(m, 7)` detections.
        block: `(m,)`.
        rows: where tracks of the pairs are written; as long as the shorter side.
        numbers: detections likewise.
        start: first detection that counts.
        stop: the one after the last.
        stretch: reach over radius, `costs.reach_over_radius`.
        threshold: on the cost.
    """

def settle(
    cells: IntArray,
    matched: IntArray,
    detections: IntArray,
    order: IntArray,
    count: int,
    most: int,
    /,
) -> int:
    """`tracking.rows.RowTable.settle`: writes the order of so many rows, says how many live on.

    Detections of the matched rows are put in that order.
    """

def arrange(matrix: NDArray[Any], order: IntArray, /) -> None:
    """Column `order[i]` becomes column i, in place."""

def say(
    boxes: FloatArray,
    state: Single,
    rows: IntArray,
    places: IntArray,
    said_boxes: FloatArray,
    said_velocity: FloatArray,
    velocity: int,
    /,
) -> None:
    """Box and velocity of each row to its place, in `(places, 7)` and `(places, 3)`."""

def birth(
    layout: IntArray,
    newborn: Single,
    kinds: IntArray,
    measured: FloatArray,
    seen: Single,
    detections: IntArray,
    boxes: FloatArray,
    state: Single,
    first: int,
    /,
) -> None:
    """`PackedKalman.birth`, given what is newborn of each kind."""

def predict(
    layout: IntArray,
    boxes: FloatArray,
    state: Single,
    times: Single,
    frames: IntArray,
    damping: FloatArray,
    prior: FloatArray,
    limit: Single,
    encoder: Single,
    heads_in: Single,
    heads_out: Single,
    /,
) -> None:
    """`PackedKalman.predict` with the layers of `network.residual_layers`, which may have no rows.

    Damping is `(n,)` or none; prior boxes are written to `prior` `(7, n)`.
    """

def update(
    layout: IntArray,
    boxes: FloatArray,
    state: Single,
    measured: FloatArray,
    seen: Single,
    detections: IntArray,
    limit: Single,
    gates: Single,
    kept: Single,
    candidate: Single,
    read_out: Single,
    /,
) -> None:
    """`PackedKalman.update` with the layers of `network.gain_layers`, which may have no rows."""

def local_fit(
    owner: IntArray,
    time_s: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    fitted: FloatArray,
    reach_s: float,
    /,
) -> None:
    """`tracking.local_fit.local_fit` into `fitted`, shaped like the values."""

def lines(
    frame_index: IntArray,
    track_id: IntArray,
    kind: IntArray,
    words: bytes,
    ends: IntArray,
    values: FloatArray,
    text: NDArray[np.uint8],
    /,
) -> int:
    """A line a track and frame: both integers, a word, and values to four decimals.

    Args:
        frame_index: `(n,)`.
        track_id: `(n,)`.
        kind: `(n,)` number of the word.
        words: one after the other.
        ends: `(words + 1,)` 0 and where each ends.
        values: `(columns, n)`; written without zeros at the end.
        text: room for the lines, `n` times the longest word and 22 more for each number.

    Returns:
        How many bytes were written; -1 if a value is not finite or not smaller than 10^9.
    """
