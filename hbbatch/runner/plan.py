"""What a run has to do: which sequences are up to date, and which are not.

A sequence is up to date when its status file says done, carries the key that its inputs, the
settings, the weights and the code give today, and its outputs exist. That one rule gives resuming,
idempotence and incremental relabelling (docs/adr/0003-status-key.md).
"""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

import hbbatch
from hbbatch.config import TrackSettings
from hbbatch.dataset import Run
from hbbatch.errors import UsageError
from hbbatch.runner.dealing import SequenceJob
from hbbatch.runner.status import is_done, read_status

_DECIDES_RESULTS: Final = (
    "tracking/*.py",
    "tracking/*.yaml",
    "model/*.py",
    "motion/*.py",
    "packed/*.py",
    "packed/c/*.[ch]",
    "c/*.[ch]",
    "boxes.py",
    "overlap.py",
    "projection.py",
    "schema.py",
    "config.py",
    "sinks/kitti.py",
)


@dataclass(frozen=True)
class Plan:
    """Sequences to track and sequences whose outputs are current.

    Attributes:
        to_do: to track.
        up_to_date: ids of sequences with current outputs.
        outdated: ids among `to_do` that had outputs, made from other inputs, settings or code.
    """

    to_do: tuple[SequenceJob, ...]
    up_to_date: tuple[str, ...]
    outdated: tuple[str, ...]


@cache
def code_version() -> str:
    """Version of the package and a short hash of the source files that decide results."""
    root = Path(hbbatch.__file__).parent
    digest = hashlib.sha256()
    for pattern in _DECIDES_RESULTS:
        for path in sorted(root.glob(pattern)):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{hbbatch.__version__}+{digest.hexdigest()[:12]}"


def sequence_key(content_hash: str, settings: TrackSettings, weights_hash: str) -> str:
    """Hash of everything that decides the outputs of a sequence."""
    return _hash(content_hash, recipe(settings, weights_hash))


def recipe(settings: TrackSettings, weights_hash: str) -> str:
    """Hash of what decides the outputs of all sequences of a run alike."""
    return _hash(settings.model_dump_json(), weights_hash, code_version())


def _hash(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


def select(catalog: pa.Table, wanted: Sequence[str]) -> list[dict[str, Any]]:
    """Catalogue rows of the wanted sequences, of all where none is named.

    Raises:
        UsageError: an id is not in the catalogue, or the catalogue is empty.
    """
    rows = {row["sequence_id"]: row for row in catalog.to_pylist()}
    unknown = [sequence_id for sequence_id in wanted if sequence_id not in rows]
    if unknown:
        raise UsageError(f"{_unknown(unknown)} {_suggestion(unknown[0], list(rows))}")
    if not rows:
        raise UsageError("The dataset holds no sequence. Run `hbbatch ingest` first.")
    return [rows[sequence_id] for sequence_id in sorted(set(wanted) or rows)]


def _unknown(ids: Sequence[str]) -> str:
    shown = ", ".join(repr(sequence_id) for sequence_id in ids[:5])
    return f"no such sequence in the dataset: {shown}{', ...' if len(ids) > 5 else ''}."


def _suggestion(sequence_id: str, known: list[str]) -> str:
    close = difflib.get_close_matches(sequence_id, known, n=3)
    if close:
        return f"Did you mean {' or '.join(close)}?"
    return f"It holds {len(known)}, from {known[0]} to {known[-1]}." if known else "It is empty."


def make_plan(
    rows: Sequence[dict[str, Any]], run: Run, settings: TrackSettings, weights_hash: str
) -> Plan:
    """Compare what the status files of a run say with what the catalogue rows ask for."""
    to_do, up_to_date, outdated = [], [], []
    for row in rows:
        sequence_id = row["sequence_id"]
        key = sequence_key(row["content_hash"], settings, weights_hash)
        status = read_status(run, sequence_id)
        if status.get("key") == key and is_done(run, sequence_id, status):
            up_to_date.append(sequence_id)
            continue
        to_do.append(job_of(row, key))
        if status.get("state") == "done" and status.get("key") != key:
            outdated.append(sequence_id)
    return Plan(tuple(to_do), tuple(up_to_date), tuple(outdated))


def job_of(row: dict[str, Any], key: str) -> SequenceJob:
    """The job that a row of the catalogue asks for."""
    return SequenceJob(
        row["sequence_id"], row["source_hash"], key, row["frames"], row["detections"]
    )
