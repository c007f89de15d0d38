"""run.json: what a run was made from, so that it can be understood and made again."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, Final

from hbbatch import schema
from hbbatch.config import TrackSettings
from hbbatch.dataset import Run, write_aside
from hbbatch.dataset.store import write_json
from hbbatch.errors import DatasetError
from hbbatch.runner.plan import code_version
from hbbatch.runner.status import read_status

_PACKAGES: Final = ("numpy", "pyarrow", "scipy", "torch")


def write_manifest(
    run: Run,
    settings: TrackSettings,
    recipe: str,
    weights_hash: str,
    inputs: Mapping[str, str],
    environment: Mapping[str, str],
) -> None:
    """Write or renew a run's manifest.

    Args:
        run: where.
        settings: resolved settings of the last time the run was made or added to.
        recipe: hash of what decides outputs; status files name that of theirs.
        weights_hash: hash of the weights' content.
        inputs: content hash by sequence id; ids the run held before are kept.
        environment: how it was started: command line, device.
    """
    before = read_manifest(run)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    write_json(
        run.manifest,
        {
            "format_version": schema.FORMAT_VERSION,
            "created": before.get("created", now),
            "updated": now,
            "settings": settings.model_dump(mode="json"),
            "recipe": recipe,
            "weights": {"name": settings.weights, "hash": weights_hash},
            "code_version": code_version(),
            "inputs": {**before.get("inputs", {}), **inputs},
            "versions": {package: version(package) for package in _PACKAGES},
            **environment,
        },
    )


def read_manifest(run: Run) -> dict[str, Any]:
    """Content of a run's manifest; empty where there is none.

    Raises:
        DatasetError: it is damaged, or the run was written by a newer version.
    """
    try:
        content = json.loads(run.manifest.read_text())
        written_by = int(content["format_version"])
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DatasetError(
            f"{run.manifest}: not a readable run manifest ({error}). "
            f"Delete the folder {run.root} or choose another run with --run."
        ) from error
    if written_by > schema.FORMAT_VERSION:
        raise DatasetError(
            f"{run.manifest}: written by a newer hbbatch (format {written_by}, this one reads up "
            f"to {schema.FORMAT_VERSION}). Upgrade hbbatch or choose another run with --run."
        )
    return dict(content)


@contextmanager
def kept_if_nothing_comes(run: Run, sequence_ids: Iterable[str], recipe: str) -> Iterator[None]:
    """Where nothing comes of a run, its manifest still speaks of what it holds, if anything.

    A new run that no worker could start would be `eval`'s default.

    Args:
        run: whose manifest is about to change.
        sequence_ids: what is to be tracked.
        recipe: what with.
    """
    before = run.manifest.read_bytes() if run.manifest.is_file() else None
    try:
        yield
    except BaseException:
        if all(read_status(run, i).get("recipe") != recipe for i in sequence_ids):
            _put_back(run, before)
        raise


def _put_back(run: Run, manifest: bytes | None) -> None:
    if manifest is not None:
        with write_aside(run.manifest) as aside:
            aside.write_bytes(manifest)
        return
    with suppress(OSError):  # something else lies there
        run.manifest.unlink(missing_ok=True)
        run.timing.unlink(missing_ok=True)
        run.root.rmdir()
