"""A run's tracks held against the labels of its dataset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa

from hbbatch.dataset import Dataset, Run
from hbbatch.errors import DatasetError, HbbatchError, SequenceError, UsageError
from hbbatch.evaluation.box_3d import evaluate_boxes
from hbbatch.evaluation.kitti import (
    KITTI_CLASSES,
    KittiTracks,
    evaluate_kitti,
    kitti_tracks,
    kitti_truth,
)
from hbbatch.evaluation.kitti_results import read_kitti_results
from hbbatch.evaluation.results import Evaluation, Protocol
from hbbatch.model.weights_files import read_header, weights_path
from hbbatch.projection import Camera
from hbbatch.runner.class_names import recorded_names
from hbbatch.runner.manifest import read_manifest
from hbbatch.runner.status import read_status


@dataclass(frozen=True)
class EvaluationReport:
    """What was evaluated, and how well it did.

    Attributes:
        dataset: folder of the dataset.
        run: name of the run.
        evaluation: scores and the protocol they were measured with.
        unlabelled: sequences left out because they have no labels.
        untracked_classes: labelled classes left out because the run tracked none of them.
        failed: sequences left out because they could not be evaluated, with the reason.
        perhaps_trained_on: sequences whose names are among those the run's weights learned from.
    """

    dataset: Path
    run: str
    evaluation: Evaluation
    unlabelled: list[str] = field(default_factory=list)
    untracked_classes: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    perhaps_trained_on: list[str] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return {
            "dataset": str(self.dataset),
            "run": self.run,
            **self.evaluation.to_json(),
            "unlabelled": self.unlabelled,
            "untracked_classes": self.untracked_classes,
            "failed": self.failed,
            "perhaps_trained_on": self.perhaps_trained_on,
        }


@dataclass(frozen=True)
class _Sequence:
    """What evaluating one sequence needs.

    Attributes:
        labels: its labels table.
        tracks: its tracks table.
        camera: None when the dataset has none for it.
        kitti_result: the run's KITTI result file, None when the run has none for it.
    """

    labels: pa.Table
    tracks: pa.Table
    camera: Camera | None
    kitti_result: Path | None


def evaluate(
    dataset_root: Path,
    run: str | None = None,
    sequences: Sequence[str] | None = None,
    classes: Sequence[str] | None = None,
) -> EvaluationReport:
    """Scores of a run on the labelled sequences of a dataset.

    Sequences whose labels have image boxes, and which have a camera, are scored in KITTI's 2D
    protocol; others by their 3D boxes.

    Args:
        dataset_root: folder of the dataset.
        run: name of the run; default the latest.
        sequences: ids; default all.
        classes: class names; default those that were labelled and tracked.

    Raises:
        UsageError: an unknown run, sequence or class.
        DatasetError: no dataset, no run, or no labelled sequence in it.
        SequenceError: none of the labelled sequences could be evaluated.
        MissingExtraError: TrackEval is not installed.
    """
    dataset = Dataset.open(dataset_root)
    chosen_run = dataset.existing_run(run)
    labelled, unlabelled = _split_by_labels(dataset, _choose_sequences(dataset, sequences))
    inputs, failed = _read_sequences(dataset, chosen_run, labelled)
    protocol = _protocol(inputs)
    names, untracked = _choose_classes(protocol, inputs, recorded_names(classes or ()))
    evaluation = _score(protocol, inputs, names)
    trained = _trained_on(chosen_run)
    return EvaluationReport(
        dataset_root,
        chosen_run.name,
        evaluation,
        unlabelled,
        untracked,
        failed,
        [sequence_id for sequence_id in inputs if sequence_id in trained],
    )


def _trained_on(run: Run) -> set[str]:
    """Names of the sequences that a run's weights learned from, as far as that is known."""
    try:
        name = read_manifest(run).get("weights", {}).get("name")
        about = read_header(weights_path(name)).about if name else {}
    except HbbatchError:
        return set()
    return {known.rpartition(":")[2] for known in about.get("sequences", [])}


def _choose_sequences(dataset: Dataset, wanted: Sequence[str] | None) -> list[str]:
    known = dataset.sequence_ids()
    unknown = [name for name in wanted or () if name not in known]
    if unknown:
        raise UsageError(
            f"sequence {', '.join(unknown)} is not in {dataset.root}. "
            f"It holds: {', '.join(known) or 'none'}."
        )
    return sorted(set(wanted)) if wanted else known


def _split_by_labels(dataset: Dataset, ids: Sequence[str]) -> tuple[list[str], list[str]]:
    labelled = [s for s in ids if dataset.path("labels", s).is_file()]
    if not labelled:
        raise DatasetError(
            f"{dataset.root}: none of the {len(ids)} sequences has labels to evaluate against. "
            "Ingest a source that has some."
        )
    return labelled, [s for s in ids if s not in labelled]


def _read_sequences(
    dataset: Dataset, run: Run, ids: Sequence[str]
) -> tuple[dict[str, _Sequence], dict[str, str]]:
    """Inputs by sequence id, and the reason by the id of each that cannot be read."""
    inputs, failed = {}, {}
    manifest = _manifest(run)
    replaced, sources = _other_inputs(dataset, manifest), dataset.source_hashes()
    for sequence_id in ids:
        try:
            if sequence_id in replaced:
                raise SequenceError(
                    f"sequence {sequence_id}: ingested again since run {run.name} tracked it. "
                    "Run `hbbatch track`."
                )
            _check_recipe(run, sequence_id, manifest.get("recipe"))
            read = _read_sequence(dataset, run, sequence_id)
            if dataset.path("detections", sequence_id).is_file():  # which are not needed here
                dataset.check_tables(sequence_id, sources[sequence_id])
            inputs[sequence_id] = read
        except HbbatchError as error:
            failed[sequence_id] = str(error)
    if not inputs:
        raise SequenceError(
            f"run {run.name}: none of the {len(ids)} labelled sequences can be evaluated; "
            f"the first: {next(iter(failed.values()))}"
        )
    return inputs, failed


def _check_recipe(run: Run, sequence_id: str, expected: str | None) -> None:
    """A run that some sequences were added to with other settings is scored without the rest."""
    if expected is not None and read_status(run, sequence_id).get("recipe", expected) != expected:
        raise SequenceError(
            f"sequence {sequence_id}: run {run.name} holds tracks of it made with other settings, "
            "weights or code than its run.json says. Track it again, or keep other settings in a "
            "run of their own (--run)."
        )


def _other_inputs(dataset: Dataset, manifest: dict[str, Any]) -> set[str]:
    """Ids of sequences whose tracks are of other detections than the dataset holds now."""
    tracked = manifest.get("inputs", {})
    catalog = dataset.catalog()
    now = zip(*(catalog[c].to_pylist() for c in ("sequence_id", "content_hash")), strict=True)
    return {
        sequence_id for sequence_id, content in now if tracked.get(sequence_id, content) != content
    }


def _manifest(run: Run) -> dict[str, Any]:
    """What the run says it was made from; nothing for one that was put together by hand."""
    try:
        return read_manifest(run)
    except DatasetError:
        return {}


def _read_sequence(dataset: Dataset, run: Run, sequence_id: str) -> _Sequence:
    failed = read_status(run, sequence_id).get("state", "done") != "done"
    if failed or not run.tracks(sequence_id).is_file():
        raise SequenceError(
            f"sequence {sequence_id}: not tracked in run {run.name}. Run `hbbatch track`."
        )
    labels, calibration = dataset.labels(sequence_id), dataset.calibration(sequence_id)
    what = f"calibration of sequence {sequence_id}"
    camera = Camera.from_calibration(calibration, what) if calibration else None
    result = run.kitti(sequence_id)
    return _Sequence(
        labels,
        run.read_tracks(sequence_id),
        camera,
        result if result.is_file() else None,
    )


def _protocol(inputs: dict[str, _Sequence]) -> Protocol:
    """The one protocol that fits all sequences.

    Raises:
        UsageError: some can be evaluated in the image and others cannot.
    """
    in_image = {s: _has_image_labels(sequence) for s, sequence in inputs.items()}
    if len(set(in_image.values())) > 1:
        in_space = [s for s, has in in_image.items() if not has]
        raise UsageError(
            f"{', '.join(in_space)}: labels have no image boxes while others have; name "
            "sequences of one kind."
        )
    return "kitti_2d" if all(in_image.values()) else "box_3d"


def _has_image_labels(sequence: _Sequence) -> bool:
    column = sequence.labels["image_left"]
    return sequence.camera is not None and column.null_count < max(len(column), 1)


def _choose_classes(
    protocol: Protocol, inputs: dict[str, _Sequence], wanted: Sequence[str]
) -> tuple[list[str], list[str]]:
    """Classes to evaluate, and those left out because no track has them."""
    labelled = _class_names(sequence.labels for sequence in inputs.values())
    if protocol == "kitti_2d":
        labelled = [name for name in KITTI_CLASSES if name in labelled]
    labelled = [name for name in labelled if name != "dont_care"]
    if wanted:
        return _known_classes(labelled, wanted), []
    tracked = _class_names(sequence.tracks for sequence in inputs.values())
    both = [name for name in labelled if name in tracked]
    # A run that found nothing at all deserves its zeros.
    return (both, [n for n in labelled if n not in both]) if both else (labelled, [])


def _known_classes(labelled: Sequence[str], wanted: Sequence[str]) -> list[str]:
    unknown = [name for name in wanted if name not in labelled]
    if unknown:
        raise UsageError(
            f"class {', '.join(unknown)} cannot be evaluated here. "
            f"Labelled: {', '.join(labelled) or 'none'}."
        )
    return list(dict.fromkeys(wanted))


def _class_names(tables: Iterable[pa.Table]) -> list[str]:
    return sorted({name for table in tables for name in table["class_name"].unique().to_pylist()})


def _score(protocol: Protocol, inputs: dict[str, _Sequence], classes: Sequence[str]) -> Evaluation:
    labels = {s: sequence.labels for s, sequence in inputs.items()}
    if protocol == "box_3d":
        return evaluate_boxes(labels, {s: q.tracks for s, q in inputs.items()}, classes)
    return evaluate_kitti(kitti_truth(labels, classes), _kitti_tracks(inputs, classes))


def _kitti_tracks(inputs: dict[str, _Sequence], classes: Sequence[str]) -> KittiTracks:
    """Tracks as the run's KITTI files hold them; projected where a run has tables only."""
    files = {s: q.kitti_result for s, q in inputs.items() if q.kitti_result}
    tables = {s: q.tracks for s, q in inputs.items() if not q.kitti_result}
    cameras = {s: q.camera for s, q in inputs.items() if q.camera}
    from_files = read_kitti_results(files, classes)
    from_tables = kitti_tracks(tables, cameras, classes)
    return {name: from_files[name] | from_tables[name] for name in classes}
