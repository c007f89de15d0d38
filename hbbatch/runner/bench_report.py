"""The benchmark's tables as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


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


def _section(table: Table) -> str:
    alignment = ["---", *["---:"] * (len(table.columns) - 1)]
    lines = [_line(table.columns), _line(alignment), *map(_line, table.rows)]
    note = [f"\n{table.note}"] if table.note else []
    return "\n".join([f"\n### {table.title}\n", *lines, *note])


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
