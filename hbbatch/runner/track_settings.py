"""Settings of a tracking run as a user gives them: in a file, by options, or both."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hbbatch.config import TrackSettings, validate
from hbbatch.runner.class_names import normalised_classes


def resolve_settings(config: Path | None, overrides: dict[str, Any]) -> TrackSettings:
    """Settings from a YAML file, and values that replace its keys; mappings are merged.

    Weights given as a relative path are relative to the file, or to the current folder where they
    come from `overrides`.

    Raises:
        ConfigError: the file cannot be read or a value does not validate.
    """
    given = {name: value for name, value in overrides.items() if value is not None}
    if config is None:
        return normalised_classes(validate(TrackSettings, given, "options"), "options")
    from hbbatch.yaml_files import load_yaml

    content = load_yaml(config)
    settings = validate(TrackSettings, _merged(content, given), str(config))
    settings = normalised_classes(settings, str(config))
    return settings if "weights" in given else anchored_weights(settings, config.parent)


def _merged(content: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    """Content with what is given in its place, mapping by mapping."""
    merged = content | given
    for name, value in given.items():
        if isinstance(value, dict) and isinstance(content.get(name), dict):
            merged[name] = _merged(content[name], value)
    return merged


def anchored_weights(settings: TrackSettings, folder: Path) -> TrackSettings:
    """Settings whose weights, where they are given as a relative path, lie under `folder`."""
    weights = settings.weights
    if weights is None or not weights.endswith(".safetensors"):
        return settings
    return settings.model_copy(update={"weights": str((folder / weights).resolve())})
