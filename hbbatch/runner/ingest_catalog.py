"""Rows of the catalogue that an ingest adds, replaces and removes."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from hbbatch import schema
from hbbatch.dataset import Dataset, locked

_PART: Final = re.compile(r"(.+)-\d{3,}")


def _recording_of(sequence_id: str) -> str:
    """Name of the recording that a sequence would be a part of; its own where it can be of none."""
    match = _PART.fullmatch(sequence_id)
    return match[1] if match else sequence_id


class CatalogRows:
    """Rows of the catalogue by name and by source."""

    def __init__(self, rows: Sequence[dict[str, Any]]) -> None:
        self.rows = rows
        self._named = {row["sequence_id"]: row for row in rows}
        self._parts: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)
        self._sources: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)
        for row in rows:
            self._sources[row["source"]].append(row)
            if _recording_of(row["sequence_id"]) != row["sequence_id"]:
                self._parts[_recording_of(row["sequence_id"])].append(row)

    def of(
        self, name: str, source: Path, others: Set[tuple[str, Path]] = frozenset()
    ) -> list[dict[str, Any]]:
        """Rows of a recording: its own, or those of the parts that its source was divided into.

        Args:
            name: of the recording.
            source: where it is.
            others: names and sources of recordings, which are no parts whatever they are called.
        """
        whole = [self._named[name]] if name in self._named else []
        resolved = str(source.resolve())
        return whole + [
            row
            for row in self._parts[name]
            if row["source"] == resolved and (row["sequence_id"], source) not in others
        ]

    def of_source(self, source: Path) -> list[dict[str, Any]]:
        """Rows that were read from a source."""
        return self._sources[str(source.resolve())]


@dataclass(frozen=True)
class Rival:
    """Another recording that has a name.

    Attributes:
        sequence_id: the name.
        source: where it is.
        source_hash: of its row of the catalogue; None where it is of the same command.
    """

    sequence_id: str
    source: str
    source_hash: str | None


class NamesInUse:
    """Who has the names that the recordings of a command have, or may have when divided."""

    def __init__(self, catalog: CatalogRows, found: Sequence[tuple[str, Path]]) -> None:
        """Takes names and sources of the recordings of the command, in order."""
        self._found = found
        self._first: dict[str, int] = {}
        for number, (name, _) in enumerate(found):
            self._first.setdefault(name, number)
        self._here = _by_recording(Rival(name, str(source), None) for name, source in found)
        self._there = _by_recording(
            Rival(row["sequence_id"], row["source"], row["source_hash"]) for row in catalog.rows
        )

    def rivals(self, number: int) -> list[Rival]:
        """Others that have the name of a recording of the command, or of a part it may have.

        Of several of the same name in the command the first one has it.
        """
        name, source = self._found[number]
        resolved, has_it = str(source.resolve()), self._first[name] == number
        here = [r for r in self._here[name] if r.sequence_id != name or not has_it]
        return here + [r for r in self._there[name] if r.source != resolved]


def _by_recording(rivals: Iterable[Rival]) -> defaultdict[str, list[Rival]]:
    """Under their own name, and that of the recording that they would be a part of."""
    found: defaultdict[str, list[Rival]] = defaultdict(list)
    for rival in rivals:
        for name in {rival.sequence_id, _recording_of(rival.sequence_id)}:
            found[name].append(rival)
    return found


def put_rows(
    dataset: Dataset, source: Path, rows: Sequence[dict[str, Any]], gone: Sequence[str]
) -> None:
    """Add or replace rows, and remove sequences that a source does not give any more.

    The catalogue is read again, under a lock, since others may have written to it.
    """
    if not rows and not gone:
        return
    resolved = str(source.resolve())
    with locked(dataset.root):
        former = dataset.catalog()
        owned = {
            row["sequence_id"] for row in former.to_pylist() if row["source"] == resolved
        } & set(gone)
        out = {*(row["sequence_id"] for row in rows), *owned}
        stays = [name not in out for name in former["sequence_id"].to_pylist()]
        others = former.filter(pa.array(stays, pa.bool_()))
        added = pa.Table.from_pylist(list(rows), schema=schema.CATALOG)
        dataset.write_catalog(pa.concat_tables([others, added]))
    for sequence_id in owned:
        dataset.drop_sequence(sequence_id)
