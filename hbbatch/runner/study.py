"""Cross-validated comparisons: train on some sequences, judge on the others, for each variant.

A study file names datasets (a detector each), folds by sequence and variants (how a filter is
trained and how it tracks). Everything that is chosen, the score cut included, is chosen on the
training folds. The same labelled sequences serve all datasets.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from hbbatch.config import Settings, TrackSettings, TrainSettings, load_yaml, validate
from hbbatch.dataset import Dataset, write_aside
from hbbatch.errors import ConfigError, DatasetError
from hbbatch.evaluation.kitti import (
    KittiTracks,
    KittiTruth,
    evaluate_kitti,
    kitti_tracks,
    kitti_truth,
)
from hbbatch.evaluation.results import Scores
from hbbatch.model.horizon import FilterError
from hbbatch.projection import Camera
from hbbatch.runner.train import train
from hbbatch.tracking.engine import Tracker
from hbbatch.tracking.frames import SequenceFrames, sequence_frames
from hbbatch.tracking.tracks import tracks_table

ProtocolName = Literal["gap_filled", "online"]
Progress = Callable[[str], None]

_CUT_QUANTILES = (0.0, 0.06, 0.12, 0.18, 0.25, 0.33)
"""Score cuts that are tried, as shares of the boxes they drop: scores have no common scale."""


class Variant(Settings):
    """One thing to compare."""

    name: str
    filter: Literal["hybrid", "kalman"] = "hybrid"
    train: dict[str, Any] = Field({}, description="training settings that differ")
    track: dict[str, Any] = Field({}, description="tracking settings that differ")
    train_on: tuple[str, ...] | None = Field(None, description="datasets; default: all")


class StudySettings(Settings):
    """A study file."""

    datasets: dict[str, Path]
    folds: int = Field(3, ge=2)
    classes: tuple[str, ...] = ("car",)
    protocols: tuple[ProtocolName, ...] = ("gap_filled", "online")
    seeds: tuple[int, ...] = (0,)
    variants: tuple[Variant, ...]


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
        parameters: of each variant's filter.
    """

    rows: list[StudyRow] = field(default_factory=list)
    errors: dict[str, list[dict[str, list[FilterError]]]] = field(default_factory=dict)
    parameters: dict[str, int] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return asdict(self)


@dataclass(frozen=True)
class _Material:
    """What is judged on one dataset."""

    root: Path
    sequences: list[str]
    frames: dict[str, SequenceFrames]
    cameras: dict[str, Camera]
    truth: KittiTruth


def load_study(path: Path) -> StudySettings:
    """A study file, paths relative to it.

    Raises:
        ConfigError: it cannot be read or does not validate.
    """
    study = validate(StudySettings, load_yaml(path), str(path))
    for variant in study.variants:
        unknown = set(variant.train_on or ()) - set(study.datasets)
        if unknown:
            raise ConfigError(f"{path}: variant {variant.name!r} trains on unknown {unknown}.")
        validate(TrainSettings, variant.train, f"{path}: variant {variant.name!r}, train")
        validate(TrackSettings, variant.track, f"{path}: variant {variant.name!r}, track")
    roots = {name: path.parent / root.expanduser() for name, root in study.datasets.items()}
    return study.model_copy(update={"datasets": roots})


def run_study(study: StudySettings, progress: Progress = lambda _: None) -> StudyReport:
    """Train and judge every variant, fold by fold.

    Raises:
        DatasetError: a dataset is missing or holds too few labelled sequences for the folds.
        MissingExtraError: TrackEval is not installed.
    """
    materials = {name: _material(root, study.classes) for name, root in study.datasets.items()}
    folds = _folds(materials, study.folds)
    report = StudyReport()
    with tempfile.TemporaryDirectory() as folder:
        for seed in study.seeds:
            for variant in study.variants:
                judge = _Judge(study, materials, folds, Path(folder), report, progress)
                judge.run(variant, seed)
    return report


@dataclass(frozen=True)
class _Judge:
    """What judging any variant needs."""

    study: StudySettings
    materials: Mapping[str, _Material]
    folds: list[list[str]]
    folder: Path
    report: StudyReport
    progress: Progress

    def run(self, variant: Variant, seed: int) -> None:
        """Train on all folds but one, track that one, in turn; score all folds together."""
        held_out: dict[tuple[str, ProtocolName], KittiTracks] = {}
        for number, fold in enumerate(self.folds):
            self.progress(f"{variant.name}, seed {seed}, fold {number + 1}/{len(self.folds)}")
            weights = self._trained(variant, seed, fold)
            for name, material in self.materials.items():
                for protocol in self.study.protocols:
                    tables = _track(material, variant, weights, protocol, self.study.classes)
                    for class_name in self.study.classes:
                        chosen = _with_best_cuts(material, tables, fold, class_name)
                        _add(held_out.setdefault((name, protocol), {}), chosen)
        for (name, protocol), tracks in held_out.items():
            scores = evaluate_kitti(self.materials[name].truth, tracks).classes
            for class_name, of_class in scores.items():
                row = StudyRow(variant.name, name, protocol, seed, class_name, of_class.combined)
                self.report.rows.append(row)

    def _trained(self, variant: Variant, seed: int, fold: Sequence[str]) -> Path:
        weights = self.folder / "fold.safetensors"
        settings = TrainSettings.model_validate({**variant.train, "seed": seed})
        roots = [self.study.datasets[name] for name in variant.train_on or self.study.datasets]
        trained = train(roots, weights, settings, kind=variant.filter, hold_out=fold)
        self.report.errors.setdefault(variant.name, []).append(trained.errors)
        self.report.parameters[variant.name] = trained.parameters
        return weights


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
    return _Material(root, sorted(labels), frames, cameras, kitti_truth(labels, classes))


def _folds(materials: Mapping[str, _Material], count: int) -> list[list[str]]:
    """Sequences common to all datasets, dealt so that folds have about as many frames."""
    common = set.intersection(*(set(m.sequences) for m in materials.values()))
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


def _track(
    material: _Material, variant: Variant, weights: Path, protocol: str, classes: Sequence[str]
) -> dict[str, pa.Table]:
    """Tracks tables of every sequence, uncut."""
    content = {"weights": str(weights), "classes": classes, **variant.track}
    content["output"] = {**content.get("output", {}), "protocol": protocol}
    settings = TrackSettings.model_validate({**content, "filter": variant.filter})
    tracker = Tracker(settings)
    done = tracker.track([material.frames[s] for s in material.sequences])
    return {d.frames.sequence_id: tracks_table(d, tracker.class_names) for d in done}


def _with_best_cuts(
    material: _Material, tables: Mapping[str, pa.Table], fold: Sequence[str], name: str
) -> KittiTracks:
    """The held-out tracks of a class, cut where the training sequences score best.

    Two cuts, one after the other: on the mean score of the track, on its mean score nearby.
    """
    training = {s: t for s, t in tables.items() if s not in fold}
    held_out = {s: t for s, t in tables.items() if s in fold}
    truth = {name: {s: t for s, t in material.truth[name].items() if s not in fold}}
    for column in ("track_score", "local_score"):
        trials = {cut: _above(training, name, column, cut) for cut in _cuts(training, name, column)}
        hota = {
            cut: evaluate_kitti(truth, kitti_tracks(trial, material.cameras, [name]))
            .classes[name]
            .combined.hota
            for cut, trial in trials.items()
        }
        best = max(hota, key=lambda cut: hota[cut])
        training, held_out = trials[best], _above(held_out, name, column, best)
    return kitti_tracks(held_out, material.cameras, [name])


def _cuts(tables: Mapping[str, pa.Table], name: str, column: str) -> list[float]:
    """Cuts to try, the lowest of them dropping nothing."""
    scores = np.concatenate(
        [t.filter(pc.equal(t["class_name"], name))[column].to_numpy() for t in tables.values()]
    )
    if not len(scores):
        return [0.0]
    quantiles = np.quantile(scores, _CUT_QUANTILES, method="lower")
    return sorted({float(cut) for cut in quantiles})


def _above(
    tables: Mapping[str, pa.Table], name: str, column: str, cut: float
) -> dict[str, pa.Table]:
    return {
        s: t.filter(pc.and_(pc.equal(t["class_name"], name), pc.greater_equal(t[column], cut)))
        for s, t in tables.items()
    }


def _add(target: KittiTracks, tracks: KittiTracks) -> None:
    for name, by_sequence in tracks.items():
        target.setdefault(name, {}).update(by_sequence)


def put_into_page(page: Path, study_name: str, tables: str) -> None:
    """Write tables between a study's markers in a Markdown page; a new page gets both.

    Raises:
        ConfigError: the page exists and has no such markers.
    """
    first, last = f"<!-- study: {study_name} -->", f"<!-- end of study: {study_name} -->"
    text = page.read_text() if page.exists() else f"{first}\n{last}\n"
    if first not in text or last not in text:
        raise ConfigError(f"{page}: holds no lines {first!r} and {last!r}. Add both to the page.")
    before, _, rest = text.partition(first)
    with write_aside(page) as aside:
        aside.write_text(f"{before}{first}\n\n{tables}\n{last}{rest.partition(last)[2]}")


def markdown(report: StudyReport) -> str:
    """The report as Markdown tables: scores, then filter errors."""
    return "\n".join([*_score_lines(report), "", *_error_lines(report), ""])


def _score_lines(report: StudyReport) -> list[str]:
    lines = [
        "| detections | protocol | class | variant | seed "
        "| HOTA | DetA | AssA | LocA | MOTA | IDSW |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    rows = sorted(report.rows, key=lambda r: (r.dataset, r.protocol, r.class_name))
    for row in rows:
        s = row.scores
        lines.append(
            f"| {row.dataset} | {row.protocol} | {row.class_name} | {row.variant} | {row.seed} "
            f"| {s.hota:.2f} | {s.deta:.2f} | {s.assa:.2f} | {s.loca:.2f} | {s.mota:.2f} "
            f"| {s.idsw} |"
        )
    return lines


def _error_lines(report: StudyReport) -> list[str]:
    """Plan-view errors by kind, age and frames ahead; folds weighted by their boxes."""
    names = list(report.errors)
    lines = [
        f"| kind | age | frames ahead | {' | '.join(names)} |",
        "|---|---|---|" + "---|" * len(names),
    ]
    pooled = {name: _pooled(report.errors[name]) for name in names}
    for key in pooled[names[0]] if names else ():
        kind, age, ahead = key
        values = " | ".join(f"{pooled[name].get(key, float('nan')):.3f}" for name in names)
        lines.append(f"| {kind} | {age} | {ahead or 'posterior'} | {values} |")
    return lines


def _pooled(folds: list[dict[str, list[FilterError]]]) -> dict[tuple[str, int, int], float]:
    total: dict[tuple[str, int, int], list[float]] = {}
    for errors in folds:
        for kind, of_kind in errors.items():
            for error in of_kind:
                entry = total.setdefault((kind, error.age, error.frames_ahead), [0.0, 0.0])
                entry[0] += error.plan_m * error.count
                entry[1] += error.count
    return {key: sum_m / max(count, 1.0) for key, (sum_m, count) in total.items()}
