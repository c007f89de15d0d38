"""The benchmark's tables as Markdown, and where they go in a document."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hbbatch.dataset import write_aside
from hbbatch.errors import UsageError

BEGIN: Final = "<!-- hbbatch bench: begin -->"
END: Final = "<!-- hbbatch bench: end -->"


@dataclass(frozen=True)
class Table:
    """A titled table of texts, with what it means."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    note: str = ""


def as_markdown(tables: Sequence[Table]) -> str:
    """A section for each table."""
    return "\n".join(_section(table) for table in tables)


def write_markdown(path: Path, tables: Sequence[Table]) -> None:
    """Replace what stands between the markers of a document.

    Raises:
        UsageError: the document is missing or has no markers.
    """
    before, after = around_tables(path)
    with write_aside(path) as aside:
        aside.write_text(f"{before}{BEGIN}\n{as_markdown(tables)}\n{END}{after}")


def around_tables(path: Path) -> tuple[str, str]:
    """What stands before and behind the markers of a document.

    Raises:
        UsageError: the document is missing or has no markers.
    """
    text = path.read_text() if path.is_file() else ""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise UsageError(f"{path}: no lines {BEGIN!r} and {END!r} to write between.")
    return before, after


def _section(table: Table) -> str:
    alignment = ["---", *["---:"] * (len(table.columns) - 1)]
    lines = [_line(table.columns), _line(alignment), *map(_line, table.rows)]
    note = [f"\n{table.note}"] if table.note else []
    return "\n".join([f"\n### {table.title}\n", *lines, *note])


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
