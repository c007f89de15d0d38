"""A dataset that repeats the sequences of others, to measure with more work than there is."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from hbbatch import schema
from hbbatch.dataset import Dataset

_TRACKED: Final = ("detections", "poses", "calibration")
"""Tables that tracking reads."""


def repeated_dataset(sources: Sequence[Path], root: Path, sequences: int | None = None) -> Dataset:
    """All sequences of some datasets, over and over until there are enough, as a dataset.

    Files are symbolic links, or copies where there are none. Labels are left out.

    Args:
        sources: datasets; their names and a number make the new ids.
        root: new folder.
        sequences: how many; by default each once.

    Raises:
        DatasetError: a source is no dataset, or `root` cannot be written.
    """
    datasets = [Dataset.open(path) for path in sources]
    found = [(dataset, row) for dataset in datasets for row in dataset.catalog().to_pylist()]
    target = Dataset.create(root)
    rows = []
    for number in range(len(found) if sequences is None else sequences):
        dataset, row = found[number % len(found)]
        old = row["sequence_id"]
        new = f"{dataset.root.name}-{old}-{number // len(found)}"
        _link_sequence(dataset, old, target, new)
        rows.append({**row, "sequence_id": new, "labels": 0})
    target.write_catalog(_catalog(rows))
    return target


def _catalog(rows: list[dict[str, Any]]) -> pa.Table:
    return pa.Table.from_pylist(rows, schema=schema.CATALOG)


def _link_sequence(source: Dataset, old: str, target: Dataset, new: str) -> None:
    for table in _TRACKED:
        folder = source.root / table / f"sequence_id={old}"
        for path in folder.glob("*") if folder.is_dir() else ():
            _link(path, target.root / table / f"sequence_id={new}" / path.name)


def _link(path: Path, link: Path) -> None:
    link.parent.mkdir(parents=True, exist_ok=True)
    try:
        link.symlink_to(path.resolve())
    except OSError:
        shutil.copyfile(path, link)
