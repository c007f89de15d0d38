"""`hbbatch demo`: a simulated drive, from log to scores."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from hbbatch.runner.demo import DemoReport


def demo(
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("hbbatch_demo"),
    seed: Annotated[int, typer.Option(min=0, help="Another seed is another drive.")] = 0,
) -> None:
    """Simulate a drive, ingest it, track it and hold the tracks against the truth."""
    from hbbatch.cli.eval import print_report
    from hbbatch.cli.output import print_summary
    from hbbatch.runner.demo import demo

    report = demo(out, seed)
    print_summary("Demo: a simulated drive", _lines(report))
    print_report(report.evaluation)


def _lines(report: DemoReport) -> list[tuple[str, str]]:
    from hbbatch.dataset import Dataset

    dataset = Dataset(report.dataset)
    run = dataset.run(report.run)
    steps = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in report.seconds.items())
    return [
        ("log", str(report.log)),
        ("detections", str(dataset.path("detections", report.sequence_id))),
        ("truth", str(dataset.path("labels", report.sequence_id))),
        ("tracks", str(run.tracks(report.sequence_id))),
        ("timing", str(run.timing)),
        ("took", steps),
        ("next", f"hbbatch track -d {report.dataset} --filter kalman"),
        ("", f"hbbatch eval -d {report.dataset} --run {report.run} --json"),
    ]
