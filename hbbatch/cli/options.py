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


class MotionChoice(StrEnum):
    """Motion models; the values of `config.TrainSettings.motion_model`."""

    CV = "cv"
    CA = "ca"
    CT = "ct"
