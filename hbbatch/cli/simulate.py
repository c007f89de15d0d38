"""`hbbatch simulate`: labelled datasets of simulated drives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from hbbatch.runner.simulate import SimulatedDrive


def simulate(
    dataset: Annotated[Path, typer.Argument(help="Dataset folder to add the drives to.")],
    drives: Annotated[int, typer.Option(min=1, help="How many.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Another seed is other drives.")] = 0,
    duration_s: Annotated[float, typer.Option(min=1.0, help="Length of each drive.")] = 30.0,
) -> None:
    """Make a labelled dataset of simulated drives that differ in traffic, sensor and detector."""
    from hbbatch.runner.simulate import simulate as run_simulation

    done = run_simulation(dataset, drives, seed, duration_s, on_drive=_print)
    detections, labels = sum(d.detections for d in done), sum(d.labels for d in done)
    typer.echo(
        f"{dataset}: {len(done)} drives, {detections:,} detections, {labels:,} labels. "
        f"Next: hbbatch train mine.safetensors -d {dataset}"
    )


def _print(drive: SimulatedDrive) -> None:
    typer.echo(
        f"{drive.sequence_id}: {drive.settings.rate_hz:g} Hz, "
        f"{drive.detections:,} detections, {drive.labels:,} labels"
    )
