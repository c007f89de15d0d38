"""Confidence made for a detector: the scale of its scores without labels, weights with them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from hbbatch import schema
from hbbatch.boxes import FloatArray
from hbbatch.config import (
    ConfidenceWeights,
    KindConfidence,
    OutputSettings,
    ProtocolName,
    ScoreScale,
)
from hbbatch.evaluation.persistence import persistent
from hbbatch.evaluation.verdicts import NOT_JUDGED, RIGHT, verdicts
from hbbatch.model.kinds import KIND_OF_CLASS
from hbbatch.projection import Camera
from hbbatch.runner.confidence_fit import fit
from hbbatch.tracking.confidence import features, scale_of
from hbbatch.tracking.evidence import evidence_of
from hbbatch.tracking.tracks import Evidence, TrackedSequence, tracks_table

FEWEST_DETECTIONS: Final = 100
"""Detections on persistent tracks below which a scale is not trusted."""

FEWEST_BOXES: Final = 20
"""Right and wrong boxes each, below which weights are not learned."""


@dataclass(frozen=True)
class Uncut:
    """A sequence with all its tracks, what speaks for them, and the table that would be written."""

    tracked: TrackedSequence
    evidence: Evidence
    table: pa.Table


@dataclass(frozen=True)
class Lesson:
    """Boxes of one kind of road user: what speaks for them, and whether they are right."""

    kind: str
    features: FloatArray
    detected: NDArray[np.bool_]
    right: NDArray[np.bool_]

    def take(self, rows: NDArray[np.bool_]) -> Lesson:
        """Some of the boxes."""
        return Lesson(self.kind, self.features[rows], self.detected[rows], self.right[rows])


def uncut_output(output: OutputSettings) -> OutputSettings:
    """The same protocol, with nothing left out."""
    uncut = {"score_scale": {}, "min_confidence": 0.0, "min_track_score": None, "min_detections": 1}
    return output.model_copy(update=uncut)


def uncut(
    tracked: Iterable[TrackedSequence], protocol: ProtocolName, class_names: Sequence[str]
) -> Iterator[Uncut]:
    """Sequences tracked with `uncut_output`, with their evidence and tables."""
    for done in tracked:
        known = evidence_of(protocol, done.tracks, done.frames)
        table = schema.conform(tracks_table(done, class_names), schema.TRACKS, "tracks")
        yield Uncut(done, known, table)


def score_scales(sequences: Iterable[Uncut], class_names: Sequence[str]) -> dict[str, ScoreScale]:
    """The scale of each class's scores; classes with too few detections to tell are left out."""
    tables = [sequence.table for sequence in sequences]
    if not tables:
        return {}
    name = np.concatenate([t["class_name"].to_numpy(zero_copy_only=False) for t in tables])
    score = np.concatenate([t["score"].to_numpy() for t in tables])
    persists = np.concatenate([persistent(t) for t in tables])
    scales = {}
    for wanted in class_names:
        rows = (name == wanted) & ~np.isnan(score)
        if (persists & rows).sum() >= FEWEST_DETECTIONS:
            scale = scale_of(score[rows], persists[rows])
            if scale is not None:
                scales[wanted] = scale
    return scales


def lessons(
    sequence: Uncut,
    labels: pa.Table,
    camera: Camera | None,
    scales: Mapping[str, ScoreScale],
    class_names: Sequence[str],
) -> Iterator[Lesson]:
    """What the labels of a sequence say of its boxes, class by class."""
    for name, scale in scales.items():
        found = verdicts(sequence.table, labels, camera, name)
        rows = (found != NOT_JUDGED) & (
            sequence.tracked.tracks.class_code == class_names.index(name)
        )
        known = sequence.evidence.take(rows)
        right = found[rows] == RIGHT
        yield Lesson(KIND_OF_CLASS[name], features(known, scale), known.detected, right)


def learned(by_detector: Iterable[Sequence[Lesson]]) -> dict[str, KindConfidence]:
    """Weights by kind, every detector counting the same.

    What holds for all kinds together is where each starts from, so that a kind with few boxes is
    judged sensibly. Kinds without any are left out, and so are weights for boxes without a
    detection where there are too few of them to learn from.
    """
    lessons_of = [list(of_detector) for of_detector in by_detector]
    detected = _learned([[q.take(q.detected) for q in lessons] for lessons in lessons_of])
    undetected = _learned([[q.take(~q.detected) for q in lessons] for lessons in lessons_of])
    return {
        kind: KindConfidence(detected=weights, undetected=undetected.get(kind))
        for kind, weights in detected.items()
    }


def _learned(lessons_of: Sequence[Sequence[Lesson]]) -> dict[str, ConfidenceWeights]:
    """Weights by kind from lessons of each detector; nothing where there are too few."""
    given, right, weight = _together(lessons_of)
    if min(right.sum(), (~right).sum()) < FEWEST_BOXES:
        return {}
    common = fit(given, right, weight)
    of_kind = {}
    for kind in sorted({lesson.kind for lessons in lessons_of for lesson in lessons}):
        own = _together([[q for q in lessons if q.kind == kind] for lessons in lessons_of])
        of_kind[kind] = fit(*own, common) if len(own.right) else common
    return of_kind


class _Boxes(NamedTuple):
    """Features `(n, 8)` of boxes, whether they are right, how much each counts."""

    given: FloatArray
    right: NDArray[np.bool_]
    weight: FloatArray


def _together(lessons_of: Sequence[Sequence[Lesson]]) -> _Boxes:
    """All boxes of all detectors, every detector counting the same."""
    parts = [
        _Boxes(np.empty((0, len(ConfidenceWeights.model_fields))), np.empty(0, bool), np.empty(0))
    ]
    for of_detector in lessons_of:
        if of_detector:
            right = np.concatenate([lesson.right for lesson in of_detector])
            given = np.concatenate([lesson.features for lesson in of_detector])
            parts.append(_Boxes(given, right, np.full(len(right), 1 / max(len(right), 1))))
    return _Boxes(*(np.concatenate(column) for column in zip(*parts, strict=True)))
