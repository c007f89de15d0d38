"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

DatasetOption = Annotated[
    Path,
    typer.Option(
        "--dataset", "-d", envvar="HBBATCH_DATASET", help="Dataset folder.", show_envvar=True
    ),
]
DEFAULT_DATASET = Path("hbbatch_data")
