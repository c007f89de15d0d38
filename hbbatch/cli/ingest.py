"""`hbbatch ingest`: logs and folders into the dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from hbbatch.cli.ingest_options import (
    ClassesOption,
    DetectionsOption,
    DistroOption,
    MappingOption,
    MaxGapOption,
    MessagePathOption,
    PoseTopicOption,
    SourceArgument,
    TopicOption,
    WorldFrameOption,
    source_options,
)
from hbbatch.cli.options import DEFAULT_DATASET, DatasetOption, JsonOption

if TYPE_CHECKING:
    from hbbatch.runner.ingest import IngestReport, SequenceOutcome


def ingest(
    source: SourceArgument,
    dataset: DatasetOption = DEFAULT_DATASET,
    detections: DetectionsOption = None,
    topic: TopicOption = None,
    world_frame: WorldFrameOption = None,
    pose_topic: PoseTopicOption = None,
    max_gap_s: MaxGapOption = None,
    mapping: MappingOption = None,
    msg_path: MessagePathOption = None,
    ros_distro: DistroOption = None,
    classes: ClassesOption = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes that read.")] = 1,
    force: Annotated[
        bool, typer.Option("--force", help="Ingest again what has not changed.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Read detections and ego poses from logs into the dataset; the format is found."""
    from rich.console import Console

    from hbbatch.runner.ingest import ingest as run_ingest

    options = source_options(
        detections,
        topic,
        world_frame,
        pose_topic,
        max_gap_s,
        mapping,
        msg_path,
        ros_distro,
        classes,
    )
    with Console(stderr=True).status("ingesting") as status:
        report = run_ingest(
            source,
            dataset,
            options=options,
            force=force,
            workers=workers,
            on_outcome=lambda outcome: status.update(f"ingested {outcome.sequence_id}"),
        )
    if as_json:
        _print_json(report)
    else:
        _print_table(report)
    _print_problems(report)
    raise typer.Exit(int(report.exit_status))


def _print_json(report: IngestReport) -> None:
    import json

    content = {
        "dataset": str(report.dataset_root),
        "seconds": report.seconds,
        "errors": report.errors,
        "dropped": [name for gone in report.dropped.values() for name in gone],
        "sequences": [_outcome_json(outcome) for outcome in report.outcomes],
    }
    typer.echo(json.dumps(content, indent=2))


def _outcome_json(outcome: SequenceOutcome) -> dict[str, Any]:
    return {
        **(
            outcome.row
            or {"sequence_id": outcome.sequence_id, "source": str(outcome.source.resolve())}
        ),
        "status": outcome.status.value,
        "seconds": outcome.seconds,
        "error": outcome.error,
    }


def _print_table(report: IngestReport) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("sequence", "status", box=None, pad_edge=False)
    for name in ("frames", "detections", "labels", "seconds"):
        table.add_column(name, justify="right")
    table.add_column("poses")
    for outcome in report.outcomes:
        row = outcome.row or {}
        counts = [str(row.get(name, "")) for name in ("frames", "detections", "labels")]
        status = f"{outcome.status}, partial" if outcome.partial else str(outcome.status)
        seconds = f"{outcome.seconds:.2f}"
        table.add_row(outcome.sequence_id, status, *counts, seconds, row.get("pose_origin", ""))
    console = Console(highlight=False)
    if report.outcomes:
        console.print(table)
    console.print(_summary(report), soft_wrap=True, markup=False)


def _summary(report: IngestReport) -> str:
    from collections import Counter

    counted = Counter(outcome.status for outcome in report.outcomes)
    statuses = ", ".join(f"{count} {status}" for status, count in counted.items())
    what = statuses or "nothing ingested"
    return f"{what} in {report.seconds:.1f} s; dataset {report.dataset_root}"


def _print_problems(report: IngestReport) -> None:
    """Warnings and errors, the same one of many sequences once."""
    from hbbatch.cli.output import complain_of

    sequences: dict[str, list[str]] = {}
    for outcome in report.outcomes:
        for problem in outcome.problems:
            sequences.setdefault(problem, []).append(outcome.sequence_id)
    for problem, ids in sequences.items():
        who = f"sequence {ids[0]}" if len(ids) == 1 else f"{len(ids)} sequences ({ids[0]}, …)"
        typer.echo(f"warning: {who}: {problem}", err=True)
    for notice in report.notices:
        typer.echo(f"warning: {notice}", err=True)
    complain_of(report.failures)
