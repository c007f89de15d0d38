"""`hbbatch calibrate`: which boxes to write, for a detector."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hbbatch.cli.options import DEFAULT_DATASET, DatasetsOption


def calibrate(
    out: Annotated[Path, typer.Argument(help="Settings file to write (YAML).")],
    sequence_id: Annotated[
        list[str] | None, typer.Argument(help="Sequences to look at; all by default.")
    ] = None,
    dataset: DatasetsOption = None,
    from_labels: Annotated[
        bool, typer.Option("--from-labels", help="Learn from labels what makes a box right.")
    ] = False,
    config: Annotated[
        Path | None, typer.Option(help="YAML file of settings to track with, as of `track`.")
    ] = None,
) -> None:
    """Find the scale of a detector's scores, so that unlikely boxes can be left out.

    No labels are needed. Use the file with `hbbatch track --config`.
    """
    from hbbatch.errors import UsageError
    from hbbatch.runner.calibrate import calibrate as find
    from hbbatch.runner.track_settings import resolve_settings

    if config is not None and config.resolve() == out.resolve():
        raise UsageError(
            f"{out}: the settings to track with would be written over. Choose another name, and "
            "take the output: found there over by hand."
        )
    settings = resolve_settings(config, {})
    roots, sequences = dataset or [DEFAULT_DATASET], tuple(sequence_id or ())
    report = find(roots, out, settings, sequences, from_labels=from_labels)
    for name, scale in report.scales.items():
        kind = "probabilities" if scale.probability else "scores"
        typer.echo(
            f"{name}: {kind} of lasting tracks typically {scale.typical:.3f}, "
            f"strong ones {scale.strong:.3f}"
        )
    for name in report.too_few:
        typer.echo(
            f"{name}: too few lasting tracks, or scores too alike; all detections will be written",
            err=True,
        )
    for kind in sorted({kind for kinds in report.weights.values() for kind in kinds}):
        typer.echo(f"{kind}: learned from labels what makes a box right")
    following = (
        f"hbbatch track --config {report.out}"
        if report.scales
        else "add the output.score_scale that `hbbatch calibrate` finds for each detector alone"
    )
    typer.echo(f"written to {report.out}. Next: {following}")
