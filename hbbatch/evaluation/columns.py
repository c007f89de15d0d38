"""Columns of a table as arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray


def integers(table: pa.Table, name: str) -> NDArray[np.int64]:
    """A column as int64 `(n,)`, decimals cut."""
    column: NDArray[np.int64] = table[name].to_numpy().astype(np.int64)
    return column


def floats(table: pa.Table, names: Sequence[str]) -> FloatArray:
    """Several columns side by side as float64 `(n, len(names))`, null as NaN."""
    return np.stack([np.asarray(table[name].to_numpy(), float) for name in names], axis=1)
