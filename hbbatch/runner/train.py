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
from hbbatch.dataset import write_aside
from hbbatch.dataset.store import write_json
from hbbatch.errors import DatasetError, UsageError
from hbbatch.model.calibration import Calibration
from hbbatch.model.horizon import FilterError
from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter
from hbbatch.model.kinds import KIND_OF_CLASS, KINDS
from hbbatch.model.likelihood import fit_noise
from hbbatch.model.train_settings import TrainSettings
from hbbatch.model.training import train_hybrid
from hbbatch.model.weights import Filter, weights_bytes
from hbbatch.model.weights_files import WEIGHTS_VERSION, WeightsHeader
from hbbatch.model.windows import WindowSet
from hbbatch.runner.labelled import LabelledSequences, judged, labelled_sequences

Progress = Callable[[str, int, int, float], None]
"""Called with the stage, the iteration, the number of iterations and the loss."""

_FIT_BATCH = 256
_FIT_FRAMES = 20


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
        calibration: whether the filter's covariance is right there, by kind.
    """

    path: Path
    sequences: list[str]
    held_out: list[str]
    tracklets: int
    parameters: int
    seconds: float
    losses: tuple[float, float]
    errors: dict[str, list[FilterError]]
    calibration: dict[str, list[Calibration]]

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
    used, held_out = labelled_sequences(roots).split(hold_out)
    data = used.windows(settings.measurements, settings.min_frames)
    if settings.max_tracklets is not None and settings.max_tracklets < len(data):
        chosen = torch.linspace(0, len(data) - 1, settings.max_tracklets).long()
        data = data.select(chosen)
    motion, losses = _train(data, settings, kind, progress)
    judgement = judged(motion, held_out if hold_out else used, settings.measurements)
    report = TrainReport(
        path=out,
        sequences=used.names,
        held_out=held_out.names,
        tracklets=len(data),
        parameters=sum(parameter.numel() for parameter in motion.parameters()),
        seconds=time.perf_counter() - start,
        losses=(_mean(losses[:20]), _mean(losses[-20:])),
        errors=judgement.errors,
        calibration=judgement.calibration,
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
    learned = _learned(settings)
    motion = HybridFilter(KINDS, settings.motion_model, learned=learned)
    motion.base.load_state_dict(base.state_dict())
    of_learned = data.select(torch.nonzero(torch.tensor(learned)[data.kind_code]).flatten())
    if not len(of_learned):
        raise DatasetError(
            f"no labelled {' or '.join(settings.learned_kinds) or 'kind'} to learn from. Name "
            "other learned_kinds in the training settings, or train with --filter kalman."
        )
    losses = train_hybrid(
        motion,
        of_learned,
        settings,
        lambda i, loss: progress("train", i, settings.iterations, loss),
    )
    return motion.eval(), losses


def _learned(settings: TrainSettings) -> tuple[bool, ...]:
    """For each kind whether its motion is learned."""
    return tuple(kind in settings.learned_kinds for kind in KINDS)


def _header(
    kind: str, settings: TrainSettings, licence: str, report: TrainReport, data_hash: str
) -> WeightsHeader:
    options = (
        {"motion_model": settings.motion_model, "learned": _learned(settings)}
        if kind == "hybrid"
        else {"model": settings.motion_model}
    )
    measured = report.to_json()
    about = {
        "licence": licence,
        "hbbatch": __version__,
        "settings": settings.model_dump(),
        "data_hash": data_hash,
        "sequences": report.sequences,
        "held_out": report.held_out,
        "tracklets": report.tracklets,
        "parameters": report.parameters,
        "errors": measured["errors"],
        "calibration": measured["calibration"],
    }
    return WeightsHeader(WEIGHTS_VERSION, kind, KINDS, dict(KIND_OF_CLASS), options, about)


def _hash(used: LabelledSequences) -> str:
    digest = hashlib.sha256()
    for dataset, ids in used.parts:
        for sequence_id in ids:
            for table in ("detections", "poses", "labels"):
                digest.update(dataset.path(table, sequence_id).read_bytes())
    return digest.hexdigest()


def _mean(values: list[float]) -> float:
    return sum(values) / max(len(values), 1)
