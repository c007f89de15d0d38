"""`hbbatch calibrate`: score cuts for a detector, without labels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hbbatch.cli.options import DEFAULT_DATASET, DatasetOption


def calibrate(
    out: Annotated[Path, typer.Argument(help="Settings file to write (YAML).")],
    dataset: DatasetOption = DEFAULT_DATASET,
    run: Annotated[
        str | None, typer.Option(help="A run made without score cuts; the latest by default.")
    ] = None,
) -> None:
    """Find the scores below which detections do not persist; use them with `track --config`."""
    from hbbatch.runner.calibrate import calibrate as find_cuts

    report = find_cuts(dataset, out, run)
    for name, cuts in report.cuts.items():
        track = "none" if cuts.track is None else f"{cuts.track:.3f}"
        local = "none" if cuts.local is None else f"{cuts.local:.3f}"
        typer.echo(f"{name}: track score {track}, nearby {local} ({cuts.detections:,} detections)")
    for name in report.too_few:
        typer.echo(f"{name}: too few detections to tell; left uncut", err=True)
    typer.echo(f"written to {report.out}. Next: hbbatch track --config {report.out}")
