"""Study files: which filters are compared, on which datasets, in how many folds."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from hbbatch.config import ProtocolName, Settings, TrackSettings, validate
from hbbatch.errors import ConfigError
from hbbatch.model.train_settings import TrainSettings
from hbbatch.model.weights_files import open_weights
from hbbatch.yaml_files import load_yaml


class Variant(Settings):
    """One thing to compare."""

    name: str
    filter: Literal["hybrid", "kalman"] = "hybrid"
    train: dict[str, Any] = Field({}, description="training settings that differ")
    track: dict[str, Any] = Field({}, description="tracking settings that differ")
    train_on: tuple[str, ...] | None = Field(None, description="datasets; default: all")
    also: tuple[Path, ...] = Field(
        (), description="datasets trained on as well, whole, that are not judged"
    )
    weights: str | None = Field(
        None, description="shipped name or path: used in all folds instead of training"
    )


class StudySettings(Settings):
    """A study file."""

    datasets: dict[str, Path]
    folds: int = Field(3, ge=2)
    classes: tuple[str, ...] = ("car",)
    protocols: tuple[ProtocolName, ...] = ("gap_filled", "online")
    seeds: tuple[int, ...] = (0,)
    variants: tuple[Variant, ...]


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
        if variant.weights is not None and (variant.train or variant.also):
            raise ConfigError(
                f"{path}: variant {variant.name!r} has both weights and something to train "
                "with (train, also). Remove one of them."
            )
        validate(TrainSettings, variant.train, f"{path}: variant {variant.name!r}, train")
        validate(TrackSettings, variant.track, f"{path}: variant {variant.name!r}, track")
    roots = {name: path.parent / root.expanduser() for name, root in study.datasets.items()}
    variants = tuple(_with_paths_found(variant, path.parent) for variant in study.variants)
    return study.model_copy(update={"datasets": roots, "variants": variants})


def _with_paths_found(variant: Variant, folder: Path) -> Variant:
    """The variant with relative paths made ones that lead there from anywhere.

    Raises:
        WeightsError: the weights are neither shipped nor a file, or of another filter.
    """
    also = tuple(folder / root.expanduser() for root in variant.also)
    variant = variant.model_copy(update={"also": also})
    if variant.weights is None:
        return variant
    beside = folder / variant.weights
    found = str(beside) if beside.is_file() else variant.weights
    open_weights(variant.filter, found, None)
    return variant.model_copy(update={"weights": found})
