"""`hbbatch ingest`: logs and folders into the dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hbbatch.cli.options import DEFAULT_DATASET, DatasetOption


def ingest(
    source: Annotated[list[Path], typer.Argument(help="Logs or folders.")],
    dataset: DatasetOption = DEFAULT_DATASET,
) -> None:
    """Read detections and ego poses from logs into the dataset."""
    raise NotImplementedError
