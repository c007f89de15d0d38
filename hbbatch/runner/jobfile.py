"""Declarative job files: what to ingest, how to track it, and where it goes, in one YAML file.

Paths are relative to the folder of the file. `${NAME}` in any value stands for an environment
variable, `${NAME:-default}` gives a default.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any, Final

from pydantic import Field

from hbbatch.config import DeviceName, Settings, TrackSettings, validate
from hbbatch.dataset.store import check_name
from hbbatch.errors import ConfigError, HbbatchError
from hbbatch.model.weights_files import open_weights
from hbbatch.runner.class_names import normalised_classes
from hbbatch.runner.track_settings import anchored_weights
from hbbatch.yaml_files import load_yaml

_VARIABLE: Final = re.compile(r"\$\{(?P<name>[A-Za-z_][A-Za-z0-9_]*)(?::-(?P<default>[^}]*))?\}")


class SourceJob(Settings):
    """Something to ingest."""

    path: Path = Field(description="a log, a folder of a known format, or a folder of such")
    detections: Path | None = Field(None, description="folder of detections kept apart (KITTI)")
    topics: tuple[str, ...] = Field((), description="detection topics to read from logs")


class RelabelJob(Settings):
    """All that `hbbatch relabel` is told."""

    dataset: Path = Field(description="folder of the dataset, made if there is none")
    sources: tuple[SourceJob, ...] = Field(min_length=1)
    track: TrackSettings = TrackSettings()
    run: str | None = Field(None, description="name of the run; default made from the settings")
    device: DeviceName = "auto"
    workers: int | None = Field(None, ge=1, description="worker processes; default one a core")
    evaluate: bool = Field(True, description="score the run where there are labels")


def load_job(path: Path) -> RelabelJob:
    """A job file, checked as a whole: all paths in the result are absolute and exist.

    Raises:
        ConfigError: the file, a value, a variable, a path or the weights are not right.
    """
    content = _expanded(load_yaml(path), str(path))
    job = _anchored(validate(RelabelJob, content, str(path)), path)
    faults = [*_missing(job), *_unfit(job)]
    if faults:
        raise ConfigError(f"{path}: {' '.join(faults)}")
    return job


def _expanded(value: Any, what: str) -> Any:
    if isinstance(value, dict):
        return {key: _expanded(item, what) for key, item in value.items()}
    if isinstance(value, list):
        return [_expanded(item, what) for item in value]
    if isinstance(value, str):
        return _VARIABLE.sub(lambda match: _variable(match, what), value)
    return value


def _variable(match: re.Match[str], what: str) -> str:
    value = os.environ.get(match["name"]) or match["default"]
    if value is None:
        raise ConfigError(
            f"{what}: the environment variable {match['name']} is not set. Set it, or give a "
            f"default: ${{{match['name']}:-default}}."
        )
    return value


def _anchored(job: RelabelJob, path: Path) -> RelabelJob:
    folder = path.resolve().parent
    sources = tuple(
        source.model_copy(
            update={
                "path": (folder / source.path).resolve(),
                "detections": source.detections and (folder / source.detections).resolve(),
            }
        )
        for source in job.sources
    )
    update = {
        "dataset": (folder / job.dataset).resolve(),
        "sources": sources,
        "track": normalised_classes(anchored_weights(job.track, folder), str(path)),
    }
    return job.model_copy(update=update)


def _missing(job: RelabelJob) -> list[str]:
    paths = [path for s in job.sources for path in (s.path, s.detections) if path is not None]
    return [f"{path} does not exist." for path in paths if not path.exists()]


def _unfit(job: RelabelJob) -> list[str]:
    try:
        open_weights(job.track.filter, job.track.weights, job.track.classes)
        if job.run is not None:
            check_name(job.run, "run name")
    except HbbatchError as error:
        return [str(error)]
    return []
