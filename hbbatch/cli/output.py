"""What several commands print: results on stdout, progress and complaints on stderr."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from rich.table import Table

_SHOWN_LINES = 8
_PLAIN_WIDTH = 160


def print_json(content: Mapping[str, Any]) -> None:
    """Results as JSON on stdout."""
    typer.echo(json.dumps(content, indent=2))


def print_summary(title: str, lines: Sequence[tuple[str, str]]) -> None:
    """Results as a short table of names and values on stdout."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title, title_justify="left", show_header=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in lines:
        table.add_row(name, Text(value))
    print_table(table)


def print_table(table: Table) -> None:
    """A table on stdout, at full width where that is no terminal."""
    from rich.console import Console

    console = Console()
    if not console.is_terminal:
        console = Console(width=_PLAIN_WIDTH)
    console.print(table)


def shortened(lines: Sequence[str]) -> list[str]:
    """The first lines of many, and how many more there are."""
    if len(lines) <= _SHOWN_LINES:
        return list(lines)
    return [*lines[:_SHOWN_LINES], f"... and {len(lines) - _SHOWN_LINES} more (see --json)"]


def complain_of(errors: Iterable[tuple[str, str]]) -> None:
    """Errors on stderr, a line each; those that differ in nothing but the sequence once.

    Args:
        errors: sequence id, empty where it is about no single one, and what is said of it.
    """
    said: dict[str, list[str]] = {}
    for sequence_id, error in errors:
        alike = error.replace(sequence_id, "…") if sequence_id else error
        said.setdefault(alike, []).append(error)
    for first, *others in said.values():
        more = f" (and {len(others)} more like it; see --json)" if others else ""
        complain(f"error: {first}{more}")


def complain(text: str) -> None:
    """One line on stderr."""
    typer.echo(" ".join(text.split()), err=True)


@contextmanager
def progress_bar(what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on stderr to be told (done, total); on anything but a terminal it stays silent."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Remaining

    console = Console(stderr=True)
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TextColumn(unit), Remaining())
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
