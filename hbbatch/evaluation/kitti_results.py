"""Reading KITTI tracking result files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.errors import DatasetError
from hbbatch.evaluation.kitti import KITTI_CLASSES, KittiTracks
from hbbatch.evaluation.metrics import ClassTracks

_FRAME, _ID, _TYPE, _LEFT, _SCORE = 0, 1, 2, 6, 17
_COLUMNS: Final = 18


def read_kitti_results(
    paths: dict[str, Path], classes: Sequence[str] = KITTI_CLASSES
) -> KittiTracks:
    """Tracks from KITTI result files by sequence id.

    Args:
        paths: file of each sequence: `frame id type truncated occluded alpha left top right bottom
            height width length x y z rotation_y score`, empty where there is no track.
        classes: class names to keep.

    Raises:
        DatasetError: a file is missing, or a line does not hold what the format asks for,
            or a track has two boxes in a frame.
    """
    files = {sequence_id: _read(path) for sequence_id, path in paths.items()}
    return {
        name: {s: _class_tracks(types, values, name) for s, (types, values) in files.items()}
        for name in classes
    }


def _read(path: Path) -> tuple[NDArray[np.str_], FloatArray]:
    """Types `(n,)` in lower case, and all other columns as numbers `(n, 18)` (the type is 0)."""
    try:
        lines = path.read_text().splitlines()
    except OSError as error:
        raise DatasetError(
            f"{path}: cannot be read ({error.strerror}). Track the sequence again."
        ) from error
    rows = [_split(path, number, line) for number, line in enumerate(lines, 1)]
    types = np.array([kind for kind, _ in rows], dtype=np.str_)
    values = np.array([values for _, values in rows], float).reshape(-1, _COLUMNS)
    _check_unique(path, values[:, [_FRAME, _ID]])
    return types, values


def _check_unique(path: Path, frame_and_id: FloatArray) -> None:
    pairs, count = np.unique(frame_and_id, axis=0, return_counts=True)
    for frame, track_id in pairs[count > 1][:1]:
        raise DatasetError(
            f"{path}: track {track_id:.0f} has two boxes in frame {frame:.0f}. "
            "Track the sequence again."
        )


def _split(path: Path, number: int, line: str) -> tuple[str, list[float]]:
    fields = line.split()
    try:
        kind, fields[_TYPE] = fields[_TYPE].lower(), "0"
        values = [float(field) for field in fields]
    except (ValueError, IndexError):
        values = []
    if len(values) != _COLUMNS:
        raise DatasetError(
            f"{path}, line {number}: not a KITTI tracking result of {_COLUMNS} columns. "
            "Track the sequence again."
        )
    return kind, values


def _class_tracks(types: NDArray[np.str_], values: FloatArray, class_name: str) -> ClassTracks:
    values = values[(types == class_name) & (values[:, _ID] >= 0)]
    values = values[np.argsort(values[:, _FRAME], kind="stable")]
    track_id = values[:, _ID].astype(np.int64)
    return ClassTracks(
        frame_index=values[:, _FRAME].astype(np.int64),
        track_id=track_id,
        boxes=values[:, _LEFT : _LEFT + 4],
        track_score=_mean_by_track(track_id, values[:, _SCORE]),
    )


def _mean_by_track(track_id: NDArray[np.int64], score: FloatArray) -> FloatArray:
    _, index = np.unique(track_id, return_inverse=True)
    mean: FloatArray = (np.bincount(index, score) / np.maximum(np.bincount(index), 1))[index]
    return mean
