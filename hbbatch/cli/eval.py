"""`hbbatch eval`: a run's tracks against the labels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from hbbatch.cli.options import DEFAULT_DATASET, DatasetOption, JsonOption

if TYPE_CHECKING:
    from rich.table import Table

    from hbbatch.evaluation.results import ClassScores, Scores
    from hbbatch.runner.evaluate import EvaluationReport

_PERCENT = ("hota", "deta", "assa", "loca", "mota", "idf1")
_HEADINGS = ("HOTA", "DetA", "AssA", "LocA", "MOTA", "IDF1", "IDSW", "Frag", "FP", "FN")
_PROTOCOLS = {
    "kitti_2d": "KITTI 2D protocol",
    "box_3d": "3D boxes, rotated IoU, sensor frame",
}


def evaluate(
    sequence_id: Annotated[
        list[str] | None, typer.Argument(help="Sequences; all labelled ones by default.")
    ] = None,
    dataset: DatasetOption = DEFAULT_DATASET,
    run: Annotated[str | None, typer.Option(help="Run; the latest by default.")] = None,
    class_name: Annotated[
        list[str] | None,
        typer.Option("--class", help="Class; those labelled and tracked by default. Repeatable."),
    ] = None,
    per_sequence: Annotated[
        bool, typer.Option("--per-sequence", help="A row for each sequence, too.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Score a run against the labels: HOTA, MOTA, IDF1 and their parts (TrackEval)."""
    from hbbatch.cli.output import print_json
    from hbbatch.errors import ExitStatus
    from hbbatch.runner.evaluate import evaluate

    report = evaluate(dataset, run, sequence_id, class_name)
    if as_json:
        print_json(report.to_json())
    else:
        print_report(report, per_sequence)
    if report.failed:
        raise typer.Exit(ExitStatus.FAILED)


def print_report(report: EvaluationReport, per_sequence: bool = False) -> None:
    """The scores as a table on stdout, what was left out on stderr."""
    from hbbatch.cli.output import complain, print_table

    print_table(_table(report, per_sequence))
    if report.unlabelled:
        complain(f"without labels, left out: {', '.join(report.unlabelled)}")
    if report.untracked_classes:
        complain(f"labelled but not tracked, left out: {', '.join(report.untracked_classes)}")
    if report.perhaps_trained_on:
        complain(
            "the weights may have been trained on the labels of "
            f"{', '.join(report.perhaps_trained_on)}: their scores then flatter"
        )
    for reason in report.failed.values():
        complain(f"error: {reason}")


def _table(report: EvaluationReport, per_sequence: bool) -> Table:
    from rich.table import Table

    classes = report.evaluation.classes
    count = max((len(scores.sequences) for scores in classes.values()), default=0)
    protocol = _PROTOCOLS[report.evaluation.protocol]
    table = Table(
        title=f"Run {report.run}: {protocol}, {count} sequence{'s' if count != 1 else ''}"
    )
    for heading in ("class", *(["sequence"] if per_sequence else [])):
        table.add_column(heading)
    for heading in _HEADINGS:
        table.add_column(heading, justify="right", no_wrap=True)
    for name, scores in classes.items():
        for row in _rows(scores, per_sequence):
            table.add_row(name, *row)
    return table


def _rows(scores: ClassScores, per_sequence: bool) -> list[list[str]]:
    if not per_sequence:
        return [_cells(scores.combined)]
    rows = [[sequence_id, *_cells(alone)] for sequence_id, alone in scores.sequences.items()]
    return [*rows, ["COMBINED", *_cells(scores.combined)]]


def _cells(scores: Scores) -> list[str]:
    percent = [f"{getattr(scores, name):.2f}" for name in _PERCENT]
    return [*percent, *map(str, (scores.idsw, scores.frag, scores.fp, scores.fn))]
