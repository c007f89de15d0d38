"""`hbbatch detector-errors`: how detections err, against labels."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from hbbatch.cli.options import DEFAULT_DATASET, DatasetsOption


class Kind(StrEnum):
    """Kinds of road users; the values of `model.kinds.KINDS`."""

    VEHICLE = "vehicle"
    PEDESTRIAN = "pedestrian"
    CYCLIST = "cyclist"


def detector_errors(
    dataset: DatasetsOption = None,
    kind: Annotated[Kind, typer.Option(help="Kind of road user.")] = Kind.VEHICLE,
    out: Annotated[
        Path | None,
        typer.Option(help="Markdown page for the table, between markers."),
    ] = None,
) -> None:
    """Measure how detections err, in space and time, against the labels of datasets."""
    from hbbatch.runner.detector_errors import detector_errors as measure
    from hbbatch.runner.detector_errors import markdown
    from hbbatch.runner.labelled import labelled_sequences
    from hbbatch.runner.pages import study_page

    page = out and study_page(out, f"detector errors, {kind.value}")
    if page:
        page.check()
    table = markdown(
        {
            root.name: measure(labelled_sequences([root]).trajectories(), kind.value)
            for root in dataset or [DEFAULT_DATASET]
        }
    )
    if page:
        page.put(table)
    typer.echo(table)
