"""Where the time of a run went: one row a sequence, and the totals."""

from __future__ import annotations

import re
import resource
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from hbbatch import schema

STAGES: Final = ("read", "predict", "associate", "update", "manage", "write")
"""Stages of a sequence, in order; their seconds add up to `wall_s`."""

_LINUX_STATUS: Final = Path("/proc/self/status")

TimingRow = dict[str, Any]
"""One row of `schema.TIMING`."""


def peak_rss_mb() -> float:
    """Highest resident memory of this process so far, in MB (10^6 bytes).

    What getrusage says includes, on Linux, the process that started this one, up to then.
    """
    status = _LINUX_STATUS.read_text() if _LINUX_STATUS.is_file() else ""
    if found := re.search(r"^VmHWM:\s*(\d+) kB$", status, re.MULTILINE):
        return int(found[1]) * 1024 / 1e6
    unit_bytes = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit_bytes / 1e6


def timing_table(rows: Iterable[TimingRow]) -> pa.Table:
    """Rows as a table of `schema.TIMING`, texts coded, sorted by sequence."""
    ordered = sorted(rows, key=lambda row: str(row["sequence_id"]))
    return pa.Table.from_pylist(ordered, schema=schema.coded(schema.TIMING))


def stage_seconds(rows: Sequence[TimingRow]) -> dict[str, float]:
    """Worker seconds by stage, summed over sequences."""
    return {stage: sum(row[f"{stage}_s"] for row in rows) for stage in STAGES}
