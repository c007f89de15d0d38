"""Status files: what became of each sequence of a run, and with what it was made."""

from __future__ import annotations

import json
from typing import Any

from hbbatch.dataset import Run
from hbbatch.dataset.atomic import write_unflushed
from hbbatch.dataset.store import json_text
from hbbatch.errors import HbbatchError


def read_status(run: Run, sequence_id: str) -> dict[str, Any]:
    """Content of a status file; empty where there is none or it is damaged."""
    try:
        status = json.loads(run.status(sequence_id).read_text())
    except (OSError, ValueError):
        return {}
    return status if isinstance(status, dict) else {}


def is_done(run: Run, sequence_id: str, status: dict[str, Any]) -> bool:
    """Whether the outputs a status file speaks of are all there."""
    outputs = run.tracks(sequence_id), run.kitti(sequence_id)
    return status.get("state") == "done" and all(path.is_file() for path in outputs)


def write_status(run: Run, sequence_id: str, status: dict[str, Any]) -> None:
    """Say in the run's folder what became of a sequence.

    The disk is not waited for: a sequence whose status was lost is tracked again.
    """
    with write_unflushed(run.status(sequence_id)) as aside:
        aside.write_text(json_text({"sequence_id": sequence_id, **status}))


def remove_status(run: Run, sequence_id: str) -> None:
    """Take back what was said of a sequence.

    Raises:
        HbbatchError: the folder cannot be written.
    """
    try:
        run.status(sequence_id).unlink(missing_ok=True)
    except OSError as error:
        raise HbbatchError(
            f"{run.status(sequence_id)}: cannot be replaced ({error.strerror}). "
            "Check the folder's permissions."
        ) from error
