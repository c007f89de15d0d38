"""Detections of a KITTI sequence in any of the layouts that published detectors use.

<dir>/NNNN.txt                 one file a sequence: 17 columns, or AB3DMOT's CSV of 15
<dir>/NNNN/FFFFFF.txt          one file a frame: 16 columns
<dir>/<class>/…                either of them, a folder a class
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from hbbatch.boxes import LARGEST, FloatArray, are_boxes
from hbbatch.errors import SourceError
from hbbatch.sources.base import FrameBatch, IntArray, Names, Poses
from hbbatch.sources.classes import is_known_class, normalise_class
from hbbatch.sources.kitti_geometry import SENSOR_FRAME, sensor_boxes
from hbbatch.sources.kitti_text import FRAME_LAYOUT, TextRows, parse_rows

_MAX_JUMP_FRAMES: Final = 100_000
"""Frames between two detections at most: almost three hours in which nothing is seen."""

_MOST_DIGITS: Final = 18
"""Of the name of a file a frame, so that it is a number of 64 bits."""

NOT_A_BOX: Final = (
    f"height, width and length must be greater than zero, and no value more than {LARGEST:g}"
)


@dataclass(frozen=True)
class KittiDetections:
    """All detections of a sequence, sorted by frame, else in the order of the files.

    Attributes:
        frame_index: `(n,)`.
        class_names: n names as written.
        boxes: `(n, 7)` in the sensor frame.
        scores: `(n,)`.
        image_boxes: `(n, 4)`, NaN where the file gives none.
        lines: `(n,)` line in its file, from 0.
    """

    frame_index: IntArray
    class_names: list[str]
    boxes: FloatArray
    scores: FloatArray
    image_boxes: FloatArray
    lines: IntArray

    @property
    def frames_needed(self) -> int:
        """Frames a sequence must have to hold them all."""
        return int(self.frame_index[-1]) + 1 if len(self.frame_index) else 0


def frame_batch(detections: KittiDetections, stamps_ns: IntArray, poses: Poses) -> FrameBatch:
    """All frames of a sequence with their detections."""
    frames = len(poses)
    return FrameBatch(
        timestamp_ns=stamps_ns,
        log_time_ns=None,
        frame_ids=Names.of([SENSOR_FRAME] * frames),
        poses=poses,
        box_counts=np.bincount(detections.frame_index, minlength=frames),
        boxes=detections.boxes,
        scores=detections.scores,
        class_names=Names.of(detections.class_names),
        image_boxes=detections.image_boxes,
        source_rows=detections.lines,
    )


def detection_files(folder: Path, sequence_id: str) -> list[Path]:
    """The files that hold the detections of a sequence, sorted; empty when there are none.

    Raises:
        SourceError: two folders hold the same class of the sequence.
    """
    roots: dict[str, Path] = {}
    for root in [folder, *_class_folders(folder)]:
        if not _files_in(root, sequence_id):
            continue
        kind = "" if root == folder else _class_of(root)
        if kind in roots:
            raise SourceError(
                f"sequence {sequence_id}: {roots[kind]} and {root} both hold class {kind}. "
                "Name the folder of one of them with --detections."
            )
        roots[kind] = root
    return [path for root in roots.values() for path in _files_in(root, sequence_id)]


def detected_sequences(folder: Path) -> set[str]:
    """Names in a folder of detections, or its class folders, that may be those of sequences."""
    entries = [e for root in [folder, *_class_folders(folder)] for e in root.iterdir()]
    return {e.stem for e in entries if e.is_dir() or e.suffix == ".txt"}


def _files_in(root: Path, sequence_id: str) -> list[Path]:
    whole = root / f"{sequence_id}.txt"
    return [whole] if whole.is_file() else sorted((root / sequence_id).glob("*.txt"))


def _class_folders(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.is_dir() and _class_of(p))


def _class_of(folder: Path) -> str:
    """The class that a folder's name says: `Car`, `pointrcnn_Car_val`; empty when none."""
    words = [word for word in re.split(r"[^A-Za-z]+", folder.name) if word]
    known = [normalise_class(word) for word in words if is_known_class(word)]
    return known[0] if known else ""


def read_detections(files: list[Path], sequence_id: str) -> KittiDetections:
    """The detections in the files of one sequence.

    Raises:
        SourceError: a line is malformed, a box has a size of zero or less, or a frame number is
            absurd.
    """
    parts = [_read_file(path, sequence_id) for path in files]
    check_frames(parts)
    frame_index = np.concatenate([frames for frames, _ in parts])
    order = np.argsort(frame_index, kind="stable")
    names = [name for _, rows in parts for name in rows.types]
    return KittiDetections(
        frame_index=frame_index[order],
        class_names=[names[row] for row in order],
        boxes=np.concatenate([checked_boxes(rows) for _, rows in parts])[order],
        scores=np.concatenate([rows.values["score"] for _, rows in parts])[order],
        image_boxes=np.concatenate([image_boxes(rows) for _, rows in parts])[order],
        lines=np.concatenate([rows.lines for _, rows in parts])[order],
    )


def _read_file(path: Path, sequence_id: str) -> tuple[IntArray, TextRows]:
    if path.stem == sequence_id and path.parent.name != sequence_id:
        rows = parse_rows(path)
        return rows.whole("frame", 0), rows
    if not path.stem.isdecimal() or len(path.stem) > _MOST_DIGITS:
        raise SourceError(
            f"{path}: one file a frame is named by its number, as in 000017.txt. "
            "Rename the file or move it away."
        )
    rows = parse_rows(path, FRAME_LAYOUT)
    return np.full(len(rows.lines), int(path.stem), dtype=np.int64), rows


def check_frames(parts: list[tuple[IntArray, TextRows]]) -> None:
    """Refuse a frame that lies absurdly far behind the one before: all between would be made.

    Args:
        parts: `(n,)` frame numbers and the lines they are of, for each file of a sequence.

    Raises:
        SourceError: names the first such line.
    """
    frame_index = np.concatenate([frames for frames, _ in parts])
    order = np.argsort(frame_index, kind="stable")
    jumps = np.zeros(len(order), dtype=bool)
    jumps[order] = np.diff(frame_index[order], prepend=0) > _MAX_JUMP_FRAMES
    ends = np.cumsum([len(frames) for frames, _ in parts])
    for (frames, rows), wrong in zip(parts, np.split(jumps, ends[:-1]), strict=True):
        what = f"frame {frames[np.argmax(wrong)]} is " if wrong.any() else ""
        rows.refuse(wrong, f"{what}more than {_MAX_JUMP_FRAMES:,} frames behind the one before")


def checked_boxes(rows: TextRows) -> FloatArray:
    """Boxes of lines in the sensor frame, `(n, 7)`.

    Raises:
        SourceError: a size is zero or negative.
    """
    boxes = sensor_boxes(rows.stack("height width length x y z ry"))
    rows.refuse(~are_boxes(boxes), NOT_A_BOX)
    return boxes


def image_boxes(rows: TextRows) -> FloatArray:
    """Image boxes of lines, `(n, 4)`; placeholders that span nothing become NaN."""
    boxes = rows.stack("left top right bottom")
    placeholder = (boxes[:, 2] <= boxes[:, 0]) | (boxes[:, 3] <= boxes[:, 1])
    boxes[placeholder] = np.nan
    return boxes
