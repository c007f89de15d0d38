"""`hbbatch bench`: how fast tracking is on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hbbatch.cli.options import DEFAULT_DATASET, FilterChoice


def bench(
    dataset: Annotated[
        list[Path] | None, typer.Argument(help="Dataset folders to measure stepping on.")
    ] = None,
    end_to_end: Annotated[
        list[Path] | None,
        typer.Option(help="Dataset to run `hbbatch track` on with 1 and 2 workers. Repeatable."),
    ] = None,
    sequences: Annotated[
        list[int] | None,
        typer.Option(min=1, help="Run it on so many, repeating those there are. Repeatable."),
    ] = None,
    weights: Annotated[
        str | None, typer.Option(help="Shipped weights by name, or a .safetensors file.")
    ] = None,
    filter_name: Annotated[
        FilterChoice, typer.Option("--filter", help="Filter to measure.")
    ] = FilterChoice.HYBRID,
    runs: Annotated[int, typer.Option(min=1, help="Repetitions; medians are printed.")] = 5,
    repeat: Annotated[
        list[int] | None, typer.Option(help="Repeat the first dataset so often. Repeatable.")
    ] = None,
    markdown: Annotated[
        Path | None, typer.Option(help="Write the tables into this Markdown file.")
    ] = None,
) -> None:
    """Measure frames a second, where the time goes, and what this core could do."""
    from hbbatch.cli.output import complain
    from hbbatch.config import TrackSettings, validate
    from hbbatch.runner.bench import BenchRequest
    from hbbatch.runner.bench import bench as run_bench
    from hbbatch.runner.bench_report import as_markdown
    from hbbatch.runner.pages import bench_page

    settings = {"filter": filter_name.value, "weights": weights}
    request = BenchRequest(
        datasets=tuple(dataset or [DEFAULT_DATASET]),
        end_to_end=tuple(end_to_end or ()),
        settings=validate(TrackSettings, settings, "options"),
        runs=runs,
        repeats=tuple(repeat or (1, 10)),
        sequences=tuple(sequences or (50,)),
    )
    page = markdown and bench_page(markdown)
    if page:
        page.check()
    tables = run_bench(request, lambda what: complain(f"measuring: {what}"))
    if page:
        page.put(as_markdown(tables))
    typer.echo(as_markdown(tables))
