"""A settings file for a detector, from sequences tracked without cuts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
import yaml

from hbbatch.config import KindConfidence, ProtocolName, ScoreScale, Settings, TrackSettings
from hbbatch.dataset import Dataset, write_aside
from hbbatch.errors import DatasetError, UsageError
from hbbatch.projection import Camera
from hbbatch.runner.confidence import (
    Lesson,
    Uncut,
    learned,
    lessons,
    score_scales,
    uncut,
    uncut_output,
)
from hbbatch.runner.plan import select
from hbbatch.tracking.engine import Tracker
from hbbatch.tracking.frames import sequence_frames

_MOST_SEQUENCES: Final = 60
"""Sequences looked at, evenly chosen from all: more say nothing new about a detector's scores."""


@dataclass(frozen=True)
class CalibrationReport:
    """What was found and written.

    Attributes:
        out: the settings file written.
        sequences: number of sequences looked at.
        scales: of the detector's scores, by class; empty where several detectors were given.
        too_few: classes with too few detections on persistent tracks, or scores too much alike.
        weights: learned from labels, by protocol and kind; empty where none were to be learned.
    """

    out: Path
    sequences: int
    scales: dict[str, ScoreScale]
    too_few: list[str]
    weights: dict[ProtocolName, dict[str, KindConfidence]]

    def settings(self) -> dict[str, Any]:
        """The findings as settings of a run."""
        output: dict[str, Any] = {}
        if self.scales:
            output["score_scale"] = {k: _plain(v) for k, v in self.scales.items()}
        if self.weights:
            output["confidence"] = {
                protocol: {kind: _plain(weights) for kind, weights in of_protocol.items()}
                for protocol, of_protocol in self.weights.items()
            }
        return {"output": output}


def _plain(settings: Settings) -> dict[str, Any]:
    """Values worth writing: without those that are defaults."""
    return settings.model_dump(exclude_defaults=True)


@dataclass(frozen=True)
class _Detector:
    """One dataset: what its detector found, tracked."""

    dataset: Dataset
    sequences: list[Uncut]
    class_names: tuple[str, ...]
    scales: dict[str, ScoreScale]


def calibrate(
    roots: Sequence[Path],
    out: Path,
    settings: TrackSettings,
    sequence_ids: Sequence[str] = (),
    *,
    from_labels: bool = False,
) -> CalibrationReport:
    """Find the scale of a detector's scores and write it as settings for `hbbatch track`.

    Args:
        roots: one dataset; with `from_labels` several, one a detector, share their weights.
        out: YAML file to write.
        settings: how to track; cuts in them are not applied.
        sequence_ids: which sequences to look at; all where none is named.
        from_labels: also learn from the datasets' labels what makes a box likely right.

    Raises:
        DatasetError: a dataset is missing, or holds too little to tell.
        UsageError: several datasets without labels to learn from, an unknown sequence, or a file
            to write that is not named as YAML.
        WeightsError: the settings' weights cannot be loaded.
    """
    if out.suffix not in (".yaml", ".yml"):
        raise UsageError(f"{out}: settings are written as .yaml. Choose such a name.")
    if len(roots) > 1 and not from_labels:
        raise UsageError(
            "one dataset at a time: the scale of scores belongs to one detector. "
            "Several datasets serve to learn weights from labels (--from-labels)."
        )
    detectors = [_tracked(root, settings, sequence_ids, labelled=from_labels) for root in roots]
    alone = detectors[0] if len(detectors) == 1 else None
    report = CalibrationReport(
        out,
        sum(len(d.sequences) for d in detectors),
        alone.scales if alone else {},
        _too_few(alone) if alone else [],
        _learned(roots, detectors, settings, sequence_ids) if from_labels else {},
    )
    with write_aside(out) as aside:
        aside.write_text(yaml.safe_dump(report.settings(), sort_keys=False))
    return report


def _learned(
    roots: Sequence[Path],
    detectors: Sequence[_Detector],
    settings: TrackSettings,
    sequence_ids: Sequence[str],
) -> dict[ProtocolName, dict[str, KindConfidence]]:
    """Weights of both protocols; `detectors` are tracked already, by the protocol of `settings`."""
    found = {}
    for protocol in get_args(ProtocolName):
        output = settings.output.model_copy(update={"protocol": protocol})
        chosen = settings.model_copy(update={"output": output})
        tracked = detectors
        if protocol != settings.output.protocol:
            tracked = [_tracked(root, chosen, sequence_ids, labelled=True) for root in roots]
        found[protocol] = learned([list(_lessons(d)) for d in tracked])
    if not any(found.values()):
        raise DatasetError(
            f"{', '.join(map(str, roots))}: too few labelled boxes to learn from. Ingest more "
            "labelled sequences, or calibrate without labels."
        )
    return found


def _too_few(detector: _Detector) -> list[str]:
    tables = [sequence.table for sequence in detector.sequences]
    seen = {name for table in tables for name in table["class_name"].unique().to_pylist()}
    return sorted(seen - set(detector.scales))


def _tracked(
    root: Path, settings: TrackSettings, sequence_ids: Sequence[str], *, labelled: bool
) -> _Detector:
    dataset = Dataset.open(root)
    ids = [row["sequence_id"] for row in select(dataset.catalog(), sequence_ids)]
    if labelled:
        ids = [s for s in ids if dataset.path("labels", s).is_file()]
    if not ids:
        which = "labels for none of the sequences named" if sequence_ids else "no labelled sequence"
        raise DatasetError(f"{root}: holds {which}. Ingest a source that has some.")
    chosen = sorted({ids[int(i)] for i in np.linspace(0, len(ids) - 1, _MOST_SEQUENCES)})
    output = uncut_output(settings.output)
    tracker = Tracker(settings.model_copy(update={"output": output}))
    frames = [
        sequence_frames(
            s, dataset.detections(s), dataset.poses(s), tracker.class_names, settings.min_score
        )
        for s in chosen
    ]
    sequences = list(uncut(tracker.track(frames), output.protocol, tracker.class_names))
    scales = score_scales(sequences, tracker.class_names)
    if not scales:
        raise DatasetError(
            f"{root}: too few detections on tracks that persist, or scores too much alike, to find "
            "their scale. Ingest more sequences, or set output.score_scale by hand."
        )
    return _Detector(dataset, sequences, tracker.class_names, scales)


def _lessons(detector: _Detector) -> Iterator[Lesson]:
    dataset = detector.dataset
    for sequence in detector.sequences:
        sequence_id = sequence.tracked.frames.sequence_id
        labels, calibration = dataset.labels(sequence_id), dataset.calibration(sequence_id)
        what = f"calibration of sequence {sequence_id}"
        camera = Camera.from_calibration(calibration, what) if calibration else None
        if labels is not None:
            yield from lessons(sequence, labels, camera, detector.scales, detector.class_names)
