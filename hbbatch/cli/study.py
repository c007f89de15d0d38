"""`hbbatch study`: cross-validated comparisons from one file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from hbbatch.cli.options import JsonOption


def study(
    file: Annotated[Path, typer.Argument(help="YAML file of the study (docs/accuracy.md).")],
    out: Annotated[
        Path | None,
        typer.Option(help="Markdown page for the tables, between markers."),
    ] = None,
    keep: Annotated[
        Path | None,
        typer.Option(
            help="Folder for trained weights; an interrupted study goes on with what is there."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Train and judge variants by cross-validation over sequences; print the tables."""
    from hbbatch.runner.pages import study_page
    from hbbatch.runner.study import run_study
    from hbbatch.runner.study_file import load_study
    from hbbatch.runner.study_tables import markdown

    page = out and study_page(out, file.name)
    if page:
        page.check()
    report = run_study(load_study(file), lambda what: typer.echo(what, err=True), keep)
    tables = markdown(report)
    if page:
        page.put(tables)
    typer.echo(json.dumps(report.to_json(), indent=2) if as_json else tables)
