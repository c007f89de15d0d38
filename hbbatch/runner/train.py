"""Filters trained on labelled sequences of one or several datasets."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from hbbatch import __version__
from hbbatch.config import TrainSettings
from hbbatch.dataset import Dataset, write_aside
from hbbatch.dataset.store import write_json
from hbbatch.errors import DatasetError, UsageError
from hbbatch.model.horizon import AGES, HORIZONS, FilterError, filter_errors
from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter
from hbbatch.model.kinds import KIND_OF_CLASS, KINDS
from hbbatch.model.likelihood import fit_noise
from hbbatch.model.training import train_hybrid
from hbbatch.model.weights import Filter, weights_bytes
from hbbatch.model.weights_files import WEIGHTS_VERSION, WeightsHeader
from hbbatch.model.windows import WindowSet, window_set
from hbbatch.tracking.frames import sequence_frames
from hbbatch.tracking.tracklets import Trajectories, join, trajectories

Progress = Callable[[str, int, int, float], None]
"""Called with the stage, the iteration, the number of iterations and the loss."""

_FIT_BATCH = 256
_FIT_FRAMES = 20
_JUDGED_WINDOWS = 4000


@dataclass(frozen=True)
class TrainReport:
    """What was trained, on what, and how far off it is on sequences it has not seen.

    Attributes:
        path: the weights file.
        sequences: trained on, a `dataset:sequence` each.
        held_out: judged on; the training sequences themselves when none were held out.
        tracklets: windows trained on.
        parameters: of the filter.
        seconds: the training took.
        losses: of the first and of the last iterations.
        errors: of the held-out sequences, by kind.
    """

    path: Path
    sequences: list[str]
    held_out: list[str]
    tracklets: int
    parameters: int
    seconds: float
    losses: tuple[float, float]
    errors: dict[str, list[FilterError]]

    def to_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return {**asdict(self), "path": str(self.path)}


def train(
    roots: Sequence[Path],
    out: Path,
    settings: TrainSettings,
    *,
    kind: str = "hybrid",
    hold_out: Sequence[str] = (),
    licence: str = "unstated: that of the training data",
    progress: Progress = lambda *_: None,
) -> TrainReport:
    """Train a filter and write its weights, with what it was trained on in their header.

    The report is written beside them as JSON.

    Args:
        roots: datasets; several teach the noise of several detectors.
        out: weights file to write (.safetensors).
        settings: how to train.
        kind: "hybrid" or "kalman" (the noise of the classical filter alone).
        hold_out: sequence ids that are not trained on but judged on.
        licence: terms of the weights, kept in their header.
        progress: told every iteration.

    Raises:
        UsageError: `out` has another suffix, or a sequence to hold out does not exist.
        DatasetError: a dataset is missing, or no labelled sequence is left to train on.
    """
    if out.suffix != ".safetensors":
        raise UsageError(f"{out}: weights are written as .safetensors. Choose such a name.")
    start = time.perf_counter()
    datasets = [Dataset.open(root) for root in roots]
    labelled = [(dataset, _labelled(dataset)) for dataset in datasets]
    _check_held_out(labelled, hold_out)
    used = [(d, [s for s in ids if s not in hold_out]) for d, ids in labelled]
    judged = [(d, [s for s in ids if s in hold_out]) for d, ids in labelled] if hold_out else used
    data = _windows(used, settings, settings.min_frames)
    if settings.max_tracklets is not None and settings.max_tracklets < len(data):
        chosen = torch.linspace(0, len(data) - 1, settings.max_tracklets).long()
        data = data.select(chosen)
    motion, losses = _train(data, settings, kind, progress)
    errors = _errors(motion, _windows(judged, settings, max(AGES) + max(HORIZONS)))
    report = TrainReport(
        path=out,
        sequences=_names(used),
        held_out=_names(judged) if hold_out else [],
        tracklets=len(data),
        parameters=sum(parameter.numel() for parameter in motion.parameters()),
        seconds=time.perf_counter() - start,
        losses=(_mean(losses[:20]), _mean(losses[-20:])),
        errors=errors,
    )
    content = weights_bytes(motion, _header(kind, settings, licence, report, _hash(used)))
    with write_aside(out) as aside:
        aside.write_bytes(content)
    write_json(out.with_suffix(".json"), report.to_json())
    return report


def _train(
    data: WindowSet, settings: TrainSettings, kind: str, progress: Progress
) -> tuple[Filter, list[float]]:
    torch.manual_seed(settings.seed)
    base = KalmanFilter(KINDS, settings.motion_model)
    losses = fit_noise(
        base,
        data,
        iterations=settings.noise_iterations,
        batch=_FIT_BATCH,
        frames=_FIT_FRAMES,
        seed=settings.seed,
        progress=lambda i, loss: progress("noise", i, settings.noise_iterations, loss),
    )
    if kind == "kalman":
        return base, losses
    motion = HybridFilter(KINDS, settings.motion_model)
    motion.base.load_state_dict(base.state_dict())
    losses = train_hybrid(
        motion, data, settings, lambda i, loss: progress("train", i, settings.iterations, loss)
    )
    return motion.eval(), losses


def _labelled(dataset: Dataset) -> list[str]:
    return [s for s in dataset.sequence_ids() if dataset.path("labels", s).is_file()]


def _check_held_out(labelled: list[tuple[Dataset, list[str]]], hold_out: Sequence[str]) -> None:
    known = {s for _, ids in labelled for s in ids}
    for sequence_id in hold_out:
        if sequence_id not in known:
            raise UsageError(
                f"sequence {sequence_id!r} to hold out has no labels in "
                f"{', '.join(str(d.root) for d, _ in labelled)}. "
                f"Labelled are: {', '.join(sorted(known)) or 'none'}."
            )


def _windows(
    used: list[tuple[Dataset, list[str]]], settings: TrainSettings, min_frames: int
) -> WindowSet:
    parts = [_trajectories(dataset, s) for dataset, ids in used for s in ids]
    if not sum(len(part.seen) for part in parts):
        raise DatasetError(
            f"{', '.join(str(d.root) for d, _ in used)}: no labelled objects to train on. "
            "Ingest sequences with labels, or hold out fewer."
        )
    whole = join(parts)
    columns = {
        name: torch.from_numpy(getattr(whole, name))
        for name in ("truth", "measured", "seen", "sight_m", "score", "dt_s")
    }
    if settings.measurements == "labels":
        columns["measured"], columns["seen"] = columns["truth"], torch.ones_like(columns["seen"])
    windows = window_set(
        columns,
        torch.from_numpy(whole.first_row),
        torch.from_numpy(whole.length),
        torch.from_numpy(whole.kind_code),
        min_frames,
    )
    if not len(windows):
        raise DatasetError(
            f"{', '.join(str(d.root) for d, _ in used)}: no object is labelled and detected over "
            f"{min_frames} frames. Ingest longer sequences, or hold out fewer."
        )
    return windows


def _trajectories(dataset: Dataset, sequence_id: str) -> Trajectories:
    labels = dataset.labels(sequence_id)
    assert labels is not None  # noqa: S101 - only labelled sequences are asked for
    classes = list(KIND_OF_CLASS)
    frames = sequence_frames(
        sequence_id, dataset.detections(sequence_id), dataset.poses(sequence_id), classes
    )
    codes = {name: KINDS.index(kind) for name, kind in KIND_OF_CLASS.items()}
    return trajectories(labels, frames, classes, codes)


def _errors(motion: Filter, windows: WindowSet) -> dict[str, list[FilterError]]:
    errors = {}
    for code, kind in enumerate(KINDS):
        chosen = torch.nonzero(windows.kind_code == code).flatten()
        if len(chosen):
            count = min(len(chosen), _JUDGED_WINDOWS)
            some = chosen[torch.linspace(0, len(chosen) - 1, count).long()]
            errors[kind] = filter_errors(motion, windows.cut(some, max(AGES) + max(HORIZONS)))
    return errors


def _header(
    kind: str, settings: TrainSettings, licence: str, report: TrainReport, data_hash: str
) -> WeightsHeader:
    options = (
        {"motion_model": settings.motion_model}
        if kind == "hybrid"
        else {"model": settings.motion_model}
    )
    metrics = {k: [asdict(e) for e in errors] for k, errors in report.errors.items()}
    about = {
        "licence": licence,
        "hbbatch": __version__,
        "settings": settings.model_dump(),
        "data_hash": data_hash,
        "sequences": report.sequences,
        "held_out": report.held_out,
        "tracklets": report.tracklets,
        "parameters": report.parameters,
        "errors": metrics,
    }
    return WeightsHeader(WEIGHTS_VERSION, kind, KINDS, dict(KIND_OF_CLASS), options, about)


def _hash(used: list[tuple[Dataset, list[str]]]) -> str:
    digest = hashlib.sha256()
    for dataset, ids in used:
        for sequence_id in ids:
            for table in ("detections", "poses", "labels"):
                digest.update(dataset.path(table, sequence_id).read_bytes())
    return digest.hexdigest()


def _names(used: list[tuple[Dataset, list[str]]]) -> list[str]:
    return [f"{dataset.root.name}:{s}" for dataset, ids in used for s in ids]


def _mean(values: list[float]) -> float:
    return sum(values) / max(len(values), 1)
