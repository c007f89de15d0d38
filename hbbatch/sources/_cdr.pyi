"""Compiled from `c/`; arrays that do not fit are refused with ValueError."""

from hbbatch.sources.base import IntArray

def walk(
    steps: IntArray,
    buffer: bytes | memoryview,
    starts: IntArray,
    ends: IntArray,
    columns: IntArray,
    rows: IntArray,
    cells: IntArray,
    vocabularies: list[dict[str, int]],
    /,
) -> None:
    """Chosen fields of messages into columns.

    Args:
        steps: `(n, 5)` of `cdr_steps.Layout`.
        buffer: holds the messages.
        starts: `(m,)` where each begins, with its encapsulation.
        ends: `(m,)` where each ends.
        columns: `(c,)` in which cell each column begins.
        rows: `(2, levels)` how many rows each level has room for; how many there are is written.
        cells: all columns; floating-point numbers as their bits.
        vocabularies: texts met and their codes, which are added to.

    Raises:
        ValueError: a message is not as the steps say; what was written means nothing.
    """
