"""Labelled sequences as what filters are trained and judged on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import torch

from hbbatch.dataset import Dataset
from hbbatch.errors import DatasetError, UsageError
from hbbatch.model.calibration import Calibration, calibration
from hbbatch.model.horizon import EVERY_FRAME, SLOWER, FilterError, filter_errors
from hbbatch.model.kinds import KIND_OF_CLASS, KINDS
from hbbatch.model.weights import Filter
from hbbatch.model.windows import WindowSet, window_set
from hbbatch.tracking.frames import sequence_frames
from hbbatch.tracking.tracklets import Trajectories, join, trajectories

Measurements = Literal["detections", "labels"]

_JUDGED_WINDOWS = 4000
_CALIBRATED_FRAMES = 20


@dataclass(frozen=True)
class LabelledSequences:
    """Sequences with labels, of one or several datasets.

    Attributes:
        parts: datasets, each with the ids of its sequences.
    """

    parts: list[tuple[Dataset, list[str]]]

    @property
    def roots(self) -> str:
        """The datasets, for messages."""
        return ", ".join(str(dataset.root) for dataset, _ in self.parts)

    @property
    def names(self) -> list[str]:
        """A `dataset:sequence` each."""
        return [f"{dataset.root.name}:{s}" for dataset, ids in self.parts for s in ids]

    def split(self, hold_out: Sequence[str]) -> tuple[LabelledSequences, LabelledSequences]:
        """Those that are not held out, and those that are.

        Raises:
            UsageError: a sequence to hold out is not among them.
        """
        known = {s for _, ids in self.parts for s in ids}
        for sequence_id in hold_out:
            if sequence_id not in known:
                raise UsageError(
                    f"sequence {sequence_id!r} to hold out has no labels in {self.roots}. "
                    f"Labelled are: {', '.join(sorted(known)) or 'none'}."
                )
        rest = [(d, [s for s in ids if s not in hold_out]) for d, ids in self.parts]
        held = [(d, [s for s in ids if s in hold_out]) for d, ids in self.parts]
        return LabelledSequences(rest), LabelledSequences(held)

    def trajectories(self) -> Trajectories:
        """Labelled objects with their detections.

        Raises:
            DatasetError: there is none.
        """
        parts = [_trajectories(dataset, s) for dataset, ids in self.parts for s in ids]
        if not sum(len(part.seen) for part in parts):
            raise DatasetError(
                f"{self.roots}: no labelled objects to train on. "
                "Ingest sequences with labels, or hold out fewer."
            )
        return join(parts)

    def windows(self, measurements: Measurements, min_frames: int) -> WindowSet:
        """Every stretch of an object that starts at a detection.

        Args:
            measurements: what filters are fed, detections matched to labels or labels.
            min_frames: shortest stretch.

        Raises:
            DatasetError: there is none.
        """
        whole = self.trajectories()
        columns = {
            name: torch.from_numpy(getattr(whole, name))
            for name in ("truth", "measured", "seen", "sight_m", "score", "dt_s")
        }
        if measurements == "labels":
            columns["measured"] = columns["truth"]
            columns["seen"] = torch.ones_like(columns["seen"])
        windows = window_set(
            columns,
            torch.from_numpy(whole.first_row),
            torch.from_numpy(whole.length),
            torch.from_numpy(whole.kind_code),
            min_frames,
        )
        if not len(windows):
            raise DatasetError(
                f"{self.roots}: no object is labelled and detected over {min_frames} frames. "
                "Ingest longer sequences, or hold out fewer."
            )
        return windows


def labelled_sequences(roots: Sequence[Path]) -> LabelledSequences:
    """All sequences with labels.

    Raises:
        DatasetError: a dataset is missing, or its tables are not those of its catalogue.
    """
    datasets = [Dataset.open(root) for root in roots]
    return LabelledSequences([(dataset, _labelled(dataset)) for dataset in datasets])


def _labelled(dataset: Dataset) -> list[str]:
    sources = dataset.source_hashes()
    labelled = [s for s in sources if dataset.path("labels", s).is_file()]
    for sequence_id in labelled:
        dataset.check_tables(sequence_id, sources[sequence_id])
    return labelled


def _trajectories(dataset: Dataset, sequence_id: str) -> Trajectories:
    labels = dataset.labels(sequence_id)
    assert labels is not None  # noqa: S101 - only labelled sequences are asked for
    classes = list(KIND_OF_CLASS)
    frames = sequence_frames(
        sequence_id, dataset.detections(sequence_id), dataset.poses(sequence_id), classes
    )
    codes = {name: KINDS.index(kind) for name, kind in KIND_OF_CLASS.items()}
    return trajectories(labels, frames, classes, codes)


@dataclass(frozen=True)
class Judgement:
    """How far a filter is off, and whether its covariance says so, by kind of road user."""

    errors: dict[str, list[FilterError]] = field(default_factory=dict)
    calibration: dict[str, list[Calibration]] = field(default_factory=dict)


def judged(
    motion: Filter, sequences: LabelledSequences, measurements: Measurements = "detections"
) -> Judgement:
    """A filter held against labels.

    Raises:
        DatasetError: no object is long enough.
    """
    windows = sequences.windows(measurements, EVERY_FRAME.rows)
    judgement = Judgement()
    for code, kind in enumerate(KINDS):
        of_kind = windows.kind_code == code
        if not of_kind.any():
            continue
        some = _evenly_chosen(of_kind)
        judgement.calibration[kind] = calibration(motion, windows.cut(some, _CALIBRATED_FRAMES))
        judgement.errors[kind] = []
        for asked in (EVERY_FRAME, *SLOWER):
            long_enough = _evenly_chosen(of_kind & (windows.frames_left >= asked.rows))
            cut = windows.cut(long_enough, asked.frames, asked.stride)
            judgement.errors[kind] += filter_errors(motion, cut, asked) if len(long_enough) else []
    return judgement


def _evenly_chosen(allowed: torch.Tensor) -> torch.Tensor:
    """Numbers of the windows that are allowed, or enough of them, evenly spread."""
    chosen = torch.nonzero(allowed).flatten()
    if len(chosen) <= _JUDGED_WINDOWS:
        return chosen
    return chosen[torch.linspace(0, len(chosen) - 1, _JUDGED_WINDOWS).long()]
