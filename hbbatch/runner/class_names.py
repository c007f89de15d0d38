"""Class names as a user types them, in the spelling that datasets record."""

from __future__ import annotations

from collections.abc import Sequence

from hbbatch.config import TrackSettings
from hbbatch.sources.classes import is_known_class, normalise_class


def recorded_names(names: Sequence[str]) -> tuple[str, ...]:
    """The taxonomy's names for class names; one that it does not know stays as it is."""
    return tuple(normalise_class(name) if is_known_class(name) else name for name in names)


def normalised_classes(settings: TrackSettings) -> TrackSettings:
    """Settings whose classes, where given, have the names that datasets record."""
    if settings.classes is None:
        return settings
    return settings.model_copy(update={"classes": recorded_names(settings.classes)})
