"""Compiled from `c/`; every function refuses arrays that do not fit with ValueError.

Arrays are contiguous.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.packed.arrays import IntArray

def match(
    priors: FloatArray,
    track_block: IntArray,
    rank: IntArray,
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
        rank: `(n,)`; of tracks that cost the same the lowest one is matched first.
        boxes: `(m, 7)` detections.
        block: `(m,)`.
        rows: where tracks of the pairs are written; as long as the shorter side.
        numbers: detections likewise.
        start: first detection that counts.
        stop: the one after the last.
        stretch: reach over radius, `costs.reach_over_radius`.
        threshold: on the cost.
    """

def steps(*given: Any) -> int:
    """Lock steps one after the other: what `tracking.eager_steps` does.

    The interpreter is free for others meanwhile, unless it is asked to match. Nothing given may
    change before the call returns, but what the matcher writes.

    Args:
        given: arrays of `KnownArrays`, `FilterArrays`, damping (ramp_frames, minimum, maximum,
            max_misses of the settings, or nothing), `TrackArrays`, `SaidArrays`, `StepArrays`
            (`packed.arrays`), one after the other; then the first step, the one after the last,
            max_misses, max_misses_unconfirmed, how many misses of a coasting track are said,
            stretch and threshold as for `match`, and who matches instead if not None: it is called
            with the number of tracks, the first of the detections and the one after the last, puts
            pairs into `rows` and `numbers` and says how many.

    Returns:
        The step that was not done since columns or places for what it may add were missing; the
        one after the last if all were done.
    """

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
