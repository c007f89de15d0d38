"""Compiled from `_kernels.c`; every function refuses arrays that do not fit with ValueError."""

from hbbatch.boxes import FloatArray
from hbbatch.packed.arrays import IntArray

def match(
    fields: FloatArray,
    block: IntArray,
    shapes: FloatArray,
    reach_m: FloatArray,
    key: FloatArray,
    order: IntArray,
    rows: IntArray,
    numbers: IntArray,
    start: int,
    stop: int,
    widest_m: float,
    low_m: float,
    high_m: float,
    stretch: float,
    threshold: float,
    /,
) -> int:
    """Pairs of `association.match` with the cost ciou_3d, into `rows` and `numbers`; how many.

    Args:
        fields: `(7, n)` priors.
        block: `(n,)`.
        shapes: `(SHAPE_ROWS, m)`, of detections; these four as in `association.Targets`.
        reach_m: `(m,)`.
        key: `(m,)`.
        order: `(m,)`.
        rows: written to, of length n or more, or of as many as there are detections.
        numbers: likewise.
        start: first detection that counts.
        stop: the one after the last.
        widest_m: largest reach of those.
        low_m: of `association.Targets`.
        high_m: likewise.
        stretch: reach over radius, `costs.reach_over_radius`.
        threshold: on the cost.
    """
