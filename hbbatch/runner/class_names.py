"""Class names as a user types them, in the spelling that datasets record."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TypeVar

from hbbatch.config import OutputSettings, TrackSettings
from hbbatch.errors import ConfigError
from hbbatch.model.kinds import KIND_OF_CLASS, KINDS
from hbbatch.sources.classes import is_known_class, normalise_class

_Value = TypeVar("_Value")


def recorded_names(names: Sequence[str]) -> tuple[str, ...]:
    """The taxonomy's names for class names; one that it does not know stays as it is."""
    return tuple(normalise_class(name) if is_known_class(name) else name for name in names)


def normalised_classes(settings: TrackSettings, what: str) -> TrackSettings:
    """Settings whose classes, wherever they are named, have the names that datasets record.

    Args:
        settings: as a user wrote them.
        what: how to name them in an error: their file.

    Raises:
        ConfigError: the output is to be judged by a class or kind that no filter tracks.
    """
    output = _normalised_output(settings.output, f"{what}: output")
    classes = None if settings.classes is None else recorded_names(settings.classes)
    return settings.model_copy(update={"classes": classes, "output": output})


def _normalised_output(output: OutputSettings, where: str) -> OutputSettings:
    cut = output.min_track_score
    named_cut = _by_class(cut, f"{where}.min_track_score") if isinstance(cut, dict) else cut
    for weights in output.confidence.values():
        _check(weights, KINDS, f"{where}.confidence")
    return output.model_copy(
        update={
            "score_scale": _by_class(output.score_scale, f"{where}.score_scale"),
            "min_track_score": named_cut,
        }
    )


def _by_class(values: Mapping[str, _Value], where: str) -> dict[str, _Value]:
    named = dict(zip(recorded_names(tuple(values)), values.values(), strict=True))
    _check(named, KIND_OF_CLASS, where)
    return named


def _check(names: Collection[str], known: Collection[str], where: str) -> None:
    unknown = [repr(name) for name in names if name not in known]
    if unknown:
        raise ConfigError(f"{where}: unknown {', '.join(unknown)}. Known are {', '.join(known)}.")
