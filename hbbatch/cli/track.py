"""`hbbatch track`: detections of the dataset into tracks."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hbbatch.cli.options import (
    DEFAULT_DATASET,
    DatasetOption,
    Device,
    FilterChoice,
    JsonOption,
    ProtocolOption,
)

if TYPE_CHECKING:
    from hbbatch.config import TrackSettings
    from hbbatch.runner.track import TrackReport


def track(
    sequence_id: Annotated[
        list[str] | None, typer.Argument(help="Sequences; all of the dataset by default.")
    ] = None,
    dataset: DatasetOption = DEFAULT_DATASET,
    workers: Annotated[
        int | None, typer.Option("--workers", "-j", min=1, help="Processes; one a core by default.")
    ] = None,
    device: Annotated[Device, typer.Option(help="Where to compute.")] = Device.AUTO,
    run: Annotated[
        str | None, typer.Option(help="Name of the run; made from the settings by default.")
    ] = None,
    weights: Annotated[
        str | None, typer.Option(help="Shipped weights by name, or a .safetensors file.")
    ] = None,
    filter_name: Annotated[
        FilterChoice | None,
        typer.Option("--filter", help="hybrid: learned (default); kalman: classical baseline."),
    ] = None,
    class_name: Annotated[
        list[str] | None,
        typer.Option("--class", help="Class to track; all the weights know. Repeatable."),
    ] = None,
    min_score: Annotated[float | None, typer.Option(help="Ignore detections scored lower.")] = None,
    protocol: ProtocolOption = None,
    config: Annotated[
        Path | None, typer.Option(help="YAML file of settings; options above win over it.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Track sequences; those whose tracks are up to date are left alone."""
    from hbbatch.cli.output import complain, print_json, progress_bar
    from hbbatch.runner.processes import load_ahead

    overrides = {
        "filter": filter_name and filter_name.value,
        "weights": weights,
        "classes": class_name or None,
        "min_score": min_score,
        "output": protocol and {"protocol": protocol.value},
    }
    load_ahead(workers)
    from hbbatch.runner.track import TrackRequest
    from hbbatch.runner.track import track as run_track
    from hbbatch.runner.track_settings import resolve_settings

    request = TrackRequest(
        dataset=dataset,
        settings=resolve_settings(config, overrides),
        sequence_ids=tuple(sequence_id or ()),
        run=run,
        device=device.value,
        workers=workers,
        command=" ".join(["hbbatch", *sys.argv[1:]]),
    )
    try:
        with progress_bar("Tracking", "frames") as progress:
            report = run_track(request, progress)
    except (KeyboardInterrupt, SystemExit):
        complain("interrupted: sequences that had ended are kept, the same command goes on")
        raise
    if as_json:
        print_json(report.to_json())
    else:
        print_report(report, request.settings)
    print_failures(report)
    raise typer.Exit(report.exit_status)


def print_report(report: TrackReport, settings: TrackSettings) -> None:
    """The summary of a run on stdout, and whether its settings let weak boxes pass."""
    from hbbatch.cli.output import print_summary, shortened
    from hbbatch.packed import kernels

    effort = _effort(report) if report.tracked else []
    odd = [("odd" if not i else "", line) for i, line in enumerate(shortened(report.odd))]
    print_summary(f"Run {report.run}", [*_counts(report), *effort, *_places(report), *odd])
    if report.tracked and not settings.output.judges:
        typer.echo(
            "Weak boxes are written as well, and no predictions: the scale of this detector's "
            "scores is unknown. `hbbatch calibrate` finds it."
        )
    if report.tracked and report.device == "cpu" and not kernels.AVAILABLE:
        typer.echo(
            "This took several times as long as it could: hbbatch was installed without a C "
            "compiler. With one there, install it again."
        )


def print_failures(report: TrackReport) -> None:
    """What failed on stderr."""
    from hbbatch.cli.output import complain_of

    complain_of(report.failures)


def _counts(report: TrackReport) -> list[tuple[str, str]]:
    done = f"{len(report.tracked)} tracked, {len(report.up_to_date)} up to date"
    if report.outdated:
        done += f" ({len(report.outdated)} redone: inputs, settings, weights or code changed)"
    lines = [("sequences", f"{done}, {len(report.failed)} failed")]
    if not report.tracked and not report.failed:
        return [*lines, ("", "nothing to do: all tracks are up to date")]
    if report.partial:
        lines.append(("data loss", f"source damaged: {', '.join(report.partial)}"))
    return lines


def _effort(report: TrackReport) -> list[tuple[str, str]]:
    total_s = sum(report.stage_s.values())
    shares = (f"{stage} {part_s / total_s:.0%}" for stage, part_s in report.stage_s.items())
    workers = f"{report.workers} worker{'s' if report.workers > 1 else ''}"
    return [
        ("frames", f"{report.frames:,}"),
        ("detections", f"{report.detections:,}"),
        ("tracks", f"{report.tracks:,}"),
        ("wall time", f"{report.wall_s:.1f} s, {workers} on {report.device}, start-up included"),
        (
            "frames per s",
            f"{report.frames_per_s:,.0f} of wall time; "
            f"{report.frames_per_worker_s:,.0f} for one worker once started",
        ),
        ("time split", ", ".join(shares)),
    ]


def _places(report: TrackReport) -> list[tuple[str, str]]:
    return [
        ("written to", str(report.path)),
        ("", "tracks/ (Parquet), kitti/ (result files), timing.parquet, run.json, status/"),
    ]
