"""Options that several commands share."""

from __future__ import annotations

from enum import StrEnum
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

DatasetsOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--dataset",
        "-d",
        envvar="HBBATCH_DATASET",
        show_envvar=True,
        help="Dataset folder, a detector each; hbbatch_data by default. Repeatable.",
    ),
]

JsonOption = Annotated[bool, typer.Option("--json", help="Print the results as JSON.")]


class Device(StrEnum):
    """Where to compute; the values of `config.DeviceName`."""

    AUTO = "auto"
    CPU = "cpu"
    CUDA = "cuda"


class FilterChoice(StrEnum):
    """Motion filters; the values of `config.FilterName`."""

    HYBRID = "hybrid"
    KALMAN = "kalman"


class ProtocolChoice(StrEnum):
    """Which boxes of a track are written; the values of `config.ProtocolName`."""

    GAP_FILLED = "gap_filled"
    ONLINE = "online"


ProtocolOption = Annotated[
    ProtocolChoice | None,
    typer.Option(
        help="gap_filled (default): looks back, so gaps are filled and tracks begin earlier; "
        "online: causal, likely predictions are said as well."
    ),
]


class MotionChoice(StrEnum):
    """Motion models; the values of `config.TrainSettings.motion_model`."""

    CV = "cv"
    CA = "ca"
    CT = "ct"
