"""`hbbatch relabel`: ingest, track and evaluate what a job file names."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hbbatch.cli.options import JsonOption

if TYPE_CHECKING:
    from hbbatch.config import TrackSettings
    from hbbatch.runner.relabel import RelabelReport


def relabel(
    job: Annotated[Path, typer.Argument(help="Job file (YAML), as in pipelines/.")],
    as_json: JsonOption = False,
) -> None:
    """Ingest, track and evaluate what a job file names; only what changed is done again."""
    from hbbatch.cli.output import complain, complain_of, print_json, progress_bar
    from hbbatch.runner.jobfile import load_job
    from hbbatch.runner.relabel import relabel as run_relabel

    loaded = load_job(job)
    with progress_bar("Tracking", "frames") as progress:
        report = run_relabel(loaded, " ".join(["hbbatch", *sys.argv[1:]]), progress)
    if as_json:
        print_json(report.to_json())
    else:
        _print_report(report, loaded.track)
    for notice in (notice for ingested in report.ingested for notice in ingested.notices):
        complain(f"warning: {notice}")
    complain_of(report.failures)
    raise typer.Exit(report.exit_status)


def _print_report(report: RelabelReport, settings: TrackSettings) -> None:
    from hbbatch.cli import eval as eval_command
    from hbbatch.cli import track as track_command

    typer.echo(_ingested(report))
    if report.unchanged:
        typer.echo("Nothing has changed since the last time: nothing was done.")
        return
    if report.tracked is not None:
        track_command.print_report(report.tracked, settings)
    if report.evaluated is not None:
        eval_command.print_report(report.evaluated)


def _ingested(report: RelabelReport) -> str:
    from collections import Counter

    counts = Counter(o.status.value for ingest in report.ingested for o in ingest.outcomes)
    shown = ", ".join(f"{count} {status}" for status, count in sorted(counts.items()))
    return f"Dataset {report.dataset}: {shown}" if shown else "Nothing was ingested."
