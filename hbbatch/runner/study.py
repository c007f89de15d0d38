"""Cross-validated comparisons: train on some sequences, judge on the others, for each variant.

A study file names datasets (a detector each), folds by sequence and variants (how a filter is
trained and how it tracks). Everything that is chosen, which boxes are likely right included, is
found on the training folds. The same labelled sequences serve all datasets.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from hbbatch.config import (
    KindConfidence,
    OutputSettings,
    ProtocolName,
    ScoreScale,
    TrackSettings,
)
from hbbatch.dataset import Dataset
from hbbatch.errors import DatasetError
from hbbatch.evaluation.kitti import (
    KittiTracks,
    KittiTruth,
    evaluate_kitti,
    kitti_tracks,
    kitti_truth,
)
from hbbatch.evaluation.results import Scores
from hbbatch.model.calibration import Calibration
from hbbatch.model.horizon import FilterError
from hbbatch.model.kinds import KIND_OF_CLASS
from hbbatch.model.train_settings import TrainSettings
from hbbatch.model.weights import build_loaded
from hbbatch.model.weights_files import open_weights
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
from hbbatch.runner.labelled import (
    Judgement,
    LabelledSequences,
    judged,
    labelled_sequences,
)
from hbbatch.runner.study_file import StudySettings, Variant
from hbbatch.runner.study_smoothers import (
    DenseWindows,
    Errors,
    dense_by_name,
    posterior_errors,
    smoother_errors,
)
from hbbatch.runner.study_weights import StudyWeights
from hbbatch.tracking.confidence import confidence
from hbbatch.tracking.engine import Tracker
from hbbatch.tracking.frames import SequenceFrames, sequence_frames
from hbbatch.tracking.refine import likely

Progress = Callable[[str], None]


@dataclass(frozen=True)
class StudyRow:
    """Scores of one variant on the held-out sequences of all folds together."""

    variant: str
    dataset: str
    protocol: ProtocolName
    seed: int
    class_name: str
    scores: Scores


@dataclass
class StudyReport:
    """What a study measured.

    Attributes:
        rows: scores of the held-out sequences of all folds together.
        errors: filter errors on held-out sequences by variant, an entry a fold and seed, each by
            kind.
        calibration: whether covariances are right there, by variant as above.
        dense: posterior errors of each variant on tracks without a gap, an entry a fold and seed,
            each by dataset; then those of detections and of fitted smoothers, an entry a fold.
        parameters: of each variant's filter.
    """

    rows: list[StudyRow] = field(default_factory=list)
    errors: dict[str, list[dict[str, list[FilterError]]]] = field(default_factory=dict)
    calibration: dict[str, list[dict[str, list[Calibration]]]] = field(default_factory=dict)
    dense: dict[str, list[Errors]] = field(default_factory=dict)
    parameters: dict[str, int] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return asdict(self)


@dataclass(frozen=True)
class _Material:
    """What is judged on one dataset."""

    root: Path
    frames: dict[str, SequenceFrames]
    labels: dict[str, pa.Table]
    cameras: dict[str, Camera]
    truth: KittiTruth


def run_study(
    study: StudySettings, progress: Progress = lambda _: None, keep: Path | None = None
) -> StudyReport:
    """Train and judge every variant, fold by fold.

    Args:
        study: what to compare.
        progress: called with what is done next.
        keep: folder for trained weights, which are used again where they are there.

    Raises:
        DatasetError: a dataset is missing or holds too few labelled sequences for the folds.
        MissingExtraError: TrackEval is not installed.
    """
    _check_there(root for variant in study.variants for root in variant.also)
    materials = {name: _material(root, study.classes) for name, root in study.datasets.items()}
    folds = _folds(materials, study.folds)
    with tempfile.TemporaryDirectory() as folder:
        judge = _Judge(study, materials, folds, StudyWeights(keep or Path(folder)), progress)
        for seed in study.seeds:
            for variant in study.variants:
                judge.run(variant, seed)
        judge.smoothers()
    return judge.report


def _check_there(roots: Iterable[Path]) -> None:
    """Opens datasets that are used hours later, to fail before anything is trained."""
    for root in roots:
        Dataset.open(root)


class _Labelled(NamedTuple):
    """By dataset the labelled sequences that are not held out, and those that are."""

    used: dict[str, LabelledSequences]
    held_out: dict[str, LabelledSequences]


class _Judged(NamedTuple):
    """What a filter is worth on what was held out, and how large it is."""

    judgement: Judgement
    dense: Errors
    parameters: int


@dataclass(frozen=True)
class _Judge:
    """What judging any variant needs, and what was found so far.

    Attributes:
        judged: what weights are worth, by their path and the fold held out.
        dense: what posteriors are judged on, by the fold held out.
    """

    study: StudySettings
    materials: Mapping[str, _Material]
    folds: list[list[str]]
    weights: StudyWeights
    progress: Progress
    report: StudyReport = field(default_factory=StudyReport)
    judged: dict[tuple[Any, ...], _Judged] = field(default_factory=dict)
    dense: dict[tuple[str, ...], DenseWindows] = field(default_factory=dict)

    def run(self, variant: Variant, seed: int) -> None:
        """Train on all folds but one, track that one, in turn; score all folds together."""
        held_out: dict[tuple[str, ProtocolName], KittiTracks] = {}
        for number, fold in enumerate(self.folds):
            self.progress(f"{variant.name}, seed {seed}, fold {number + 1}/{len(self.folds)}")
            weights = self._weights(variant, seed, fold)
            for protocol in self.study.protocols:
                for name, tracks in self._tracked(variant, weights, protocol, fold).items():
                    _add(held_out.setdefault((name, protocol), {}), tracks)
        for (name, protocol), tracks in held_out.items():
            scores = evaluate_kitti(self.materials[name].truth, tracks).classes
            for class_name, of_class in scores.items():
                row = StudyRow(variant.name, name, protocol, seed, class_name, of_class.combined)
                self.report.rows.append(row)

    def smoothers(self) -> None:
        """Note what detections and smoothers fitted to them are off."""
        for fold in self.folds:
            errors = smoother_errors(dense_by_name(self._labelled(fold).used), self._dense(fold))
            for name, by_dataset in errors.items():
                self.report.dense.setdefault(name, []).append(by_dataset)

    def _dense(self, fold: Sequence[str]) -> DenseWindows:
        """Of the sequences that are held out."""
        key = tuple(fold)
        if key not in self.dense:
            self.dense[key] = dense_by_name(self._labelled(fold).held_out)
        return self.dense[key]

    def _labelled(self, fold: Sequence[str]) -> _Labelled:
        parts = {n: labelled_sequences([r]).split(fold) for n, r in self.study.datasets.items()}
        return _Labelled(
            {name: used for name, (used, _) in parts.items()},
            {name: held_out for name, (_, held_out) in parts.items()},
        )

    def _tracked(
        self, variant: Variant, weights: Path, protocol: ProtocolName, fold: Sequence[str]
    ) -> dict[str, KittiTracks]:
        """Tracks of the held-out sequences on each dataset, unlikely boxes left out.

        The scales of scores and what makes a box likely are found on the other sequences.
        """
        classes = self.study.classes
        found = {
            name: _uncut(material, variant, weights, protocol, classes)
            for name, material in self.materials.items()
        }
        seen = {
            name: {s: q for s, q in sequences.items() if s not in fold}
            for name, sequences in found.items()
        }
        scales = {name: score_scales(of.values(), classes) for name, of in seen.items()}
        weights_of_kind = learned(
            _lessons(self.materials[name], seen[name], scales[name], classes)
            for name in variant.train_on or self.materials
        )
        return {
            name: _likely(
                material,
                [found[name][s] for s in fold],
                _judging(variant, scales[name], weights_of_kind, protocol),
                classes,
            )
            for name, material in self.materials.items()
        }

    def _weights(self, variant: Variant, seed: int, fold: Sequence[str]) -> Path:
        """Weights to track a fold with; how far off they are there, on all datasets, is noted."""
        if variant.weights is None:
            path = self._trained(variant, seed, fold)
        else:
            path = open_weights(variant.filter, variant.weights, None).path
        if (path, *fold) not in self.judged:
            self.judged[path, *fold] = self._judged(variant, path, fold)
        found = self.judged[path, *fold]
        self.report.errors.setdefault(variant.name, []).append(found.judgement.errors)
        self.report.calibration.setdefault(variant.name, []).append(found.judgement.calibration)
        self.report.dense.setdefault(variant.name, []).append(found.dense)
        self.report.parameters[variant.name] = found.parameters
        return path

    def _trained(self, variant: Variant, seed: int, fold: Sequence[str]) -> Path:
        names = variant.train_on or self.study.datasets
        roots = [*(self.study.datasets[name] for name in names), *variant.also]
        settings = TrainSettings.model_validate({**variant.train, "seed": seed})
        return self.weights.trained(roots, settings, variant.filter, fold)

    def _judged(self, variant: Variant, path: Path, fold: Sequence[str]) -> _Judged:
        _, held_out = labelled_sequences(list(self.study.datasets.values())).split(fold)
        file = open_weights(variant.filter, str(path), None)
        motion = build_loaded(file)
        dense = posterior_errors(motion, self._dense(fold))
        return _Judged(judged(motion, held_out), dense, file.header.about.get("parameters", 0))


def _material(root: Path, classes: Sequence[str]) -> _Material:
    dataset = Dataset.open(root)
    labels: dict[str, pa.Table] = {}
    frames, cameras = {}, {}
    for sequence_id in dataset.sequence_ids():
        table = dataset.labels(sequence_id)
        calibration = dataset.calibration(sequence_id)
        if table is None or calibration is None:
            continue
        labels[sequence_id] = table
        cameras[sequence_id] = Camera.from_calibration(calibration, f"sequence {sequence_id}")
        frames[sequence_id] = sequence_frames(
            sequence_id, dataset.detections(sequence_id), dataset.poses(sequence_id), classes
        )
    return _Material(root, frames, labels, cameras, kitti_truth(labels, classes))


def _folds(materials: Mapping[str, _Material], count: int) -> list[list[str]]:
    """Sequences common to all datasets, dealt so that folds have about as many frames."""
    common = set.intersection(*(set(m.labels) for m in materials.values()))
    if len(common) < count:
        raise DatasetError(
            f"{len(common)} labelled sequences are common to all datasets of the study, too few "
            f"for {count} folds. Ingest more, or ask for fewer folds."
        )
    frames = next(iter(materials.values())).frames
    folds: list[list[str]] = [[] for _ in range(count)]
    size = [0] * count
    for sequence_id in sorted(common, key=lambda s: (-frames[s].frame_count, s)):
        smallest = size.index(min(size))
        folds[smallest].append(sequence_id)
        size[smallest] += frames[sequence_id].frame_count
    return folds


def _uncut(
    material: _Material,
    variant: Variant,
    weights: Path,
    protocol: ProtocolName,
    classes: Sequence[str],
) -> dict[str, Uncut]:
    """Every sequence, tracked without cuts."""
    content = {"weights": str(weights), "classes": classes, **variant.track}
    content["output"] = {**content.get("output", {}), "protocol": protocol}
    settings = TrackSettings.model_validate({**content, "filter": variant.filter})
    tracker = Tracker(settings.model_copy(update={"output": uncut_output(settings.output)}))
    done = uncut(tracker.track(list(material.frames.values())), protocol, tracker.class_names)
    return {sequence.tracked.frames.sequence_id: sequence for sequence in done}


def _lessons(
    material: _Material,
    sequences: Mapping[str, Uncut],
    scales: Mapping[str, ScoreScale],
    classes: Sequence[str],
) -> list[Lesson]:
    return [
        lesson
        for s, sequence in sequences.items()
        for lesson in lessons(sequence, material.labels[s], material.cameras[s], scales, classes)
    ]


def _judging(
    variant: Variant,
    scales: Mapping[str, ScoreScale],
    weights: dict[str, KindConfidence],
    protocol: ProtocolName,
) -> OutputSettings:
    """Settings that judge the kinds learned in this fold only: shipped weights know all folds."""
    known = {name: scale for name, scale in scales.items() if KIND_OF_CLASS[name] in weights}
    chosen = {"protocol": protocol, "score_scale": known, "confidence": {protocol: weights}}
    return OutputSettings.model_validate({**variant.track.get("output", {}), **chosen})


def _likely(
    material: _Material,
    sequences: Iterable[Uncut],
    output: OutputSettings,
    class_names: Sequence[str],
) -> KittiTracks:
    """The boxes that are likely right, in the image."""
    kept = {}
    for sequence in sequences:
        tracked = sequence.tracked
        tracks = tracked.tracks
        probability = confidence(sequence.evidence, tracks.class_code, output, class_names)
        rows = pa.array(likely(tracks, probability, output.min_confidence))
        kept[tracked.frames.sequence_id] = sequence.table.filter(rows)
    return kitti_tracks(kept, material.cameras, class_names)


def _add(target: KittiTracks, tracks: KittiTracks) -> None:
    for name, by_sequence in tracks.items():
        target.setdefault(name, {}).update(by_sequence)
