"""Rows of the catalogue that an ingest adds, replaces and removes."""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from hbbatch import schema
from hbbatch.dataset import Dataset


def former_rows(rows: Sequence[dict[str, Any]], name: str, source: Path) -> list[dict[str, Any]]:
    """Rows of a recording: its own, or those of the parts that its source was divided into."""
    part = re.compile(rf"{re.escape(name)}-\d{{3,}}")
    return [
        row
        for row in rows
        if row["sequence_id"] == name
        or (part.fullmatch(row["sequence_id"]) and row["source"] == str(source))
    ]


def put_rows(
    dataset: Dataset, source: Path, rows: Sequence[dict[str, Any]], gone: Sequence[str]
) -> None:
    """Add or replace rows, and remove sequences that a source does not give any more.

    The catalogue is read again, under a lock, since others may have written to it.
    """
    if not rows and not gone:
        return
    resolved = str(source.resolve())
    with _locked(dataset):
        former = dataset.catalog()
        owned = {
            row["sequence_id"] for row in former.to_pylist() if row["source"] == resolved
        } & set(gone)
        out = [*(row["sequence_id"] for row in rows), *owned]
        others = former.filter(~pc.field("sequence_id").isin(out))
        added = pa.Table.from_pylist(list(rows), schema=schema.CATALOG)
        dataset.write_catalog(pa.concat_tables([others, added]))
    for sequence_id in owned:
        dataset.drop_sequence(sequence_id)


@contextmanager
def _locked(dataset: Dataset) -> Iterator[None]:
    """Let one process at a time change the catalogue."""
    folder = os.open(dataset.root, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(folder)
