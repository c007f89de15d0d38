"""What every reader gives: sequences, each a stream of frames with boxes and the sensor's pose.

A reader of another format is a new file with a `Source` in it and one line in `detect.py`.
Handles of sequences are light and picklable; nothing is read before `fingerprint` or `read`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import HEIGHT, LENGTH, FloatArray
from hbbatch.errors import SourceError

IntArray = NDArray[np.int64]

LOGGED: Final = "logged"
INTERPOLATED: Final = "interpolated"
IDENTITY: Final = "identity"
POSE_ORIGINS: Final = (LOGGED, INTERPOLATED, IDENTITY)
"""How a pose was obtained, the most trustworthy first."""


@dataclass(frozen=True)
class SourceOptions:
    """What the user may say about sources; formats ignore what does not concern them.

    Attributes:
        detections: folder of detection files, for formats that keep them apart from the log.
        topics: detection topics to read, for logs; empty: the only one there is.
    """

    detections: Path | None = None
    topics: tuple[str, ...] = ()


@dataclass(frozen=True)
class Pose:
    """world_from_sensor of one frame.

    Attributes:
        translation_m: `(3,)`.
        rotation: `(4,)` unit quaternion x, y, z, w.
        origin: one of `POSE_ORIGINS`.
    """

    translation_m: FloatArray
    rotation: FloatArray
    origin: str


IDENTITY_POSE: Final = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), IDENTITY)


@dataclass(frozen=True)
class Frame:
    """One frame of a sequence: what was detected, and where the sensor was.

    Attributes:
        timestamp_ns: header stamp, since the Unix epoch.
        log_time_ns: when the recorder received it, None when the source does not say.
        frame_id: name of the sensor frame that the boxes are in.
        pose: of that sensor in the world, at the stamp.
        boxes: `(n, 7)` in the sensor frame, convention of `hbbatch.boxes`.
        scores: `(n,)` as logged.
        class_names: n names as the source wrote them.
        image_boxes: `(n, 4)` left, top, right, bottom in pixels, NaN where there is none.
        source_rows: `(n,)` line or message number it was read from, from 0.
    """

    timestamp_ns: int
    log_time_ns: int | None
    frame_id: str
    pose: Pose
    boxes: FloatArray
    scores: FloatArray
    class_names: Sequence[str]
    image_boxes: FloatArray
    source_rows: IntArray


@dataclass(frozen=True)
class Labels:
    """Labelled objects of a sequence, one row an object and frame, sorted by frame.

    Attributes:
        frame_index: `(n,)`.
        timestamp_ns: `(n,)`.
        object_id: `(n,)`, -1 marks a region to ignore.
        class_names: n names as the source wrote them.
        boxes: `(n, 7)` in the sensor frame, NaN in regions to ignore.
        frame_id: name of that frame.
        image_boxes: `(n, 4)` left, top, right, bottom in pixels, NaN where there is none.
        truncation: `(n,)` KITTI's level, -1 unknown.
        occlusion: `(n,)` KITTI's level, -1 unknown.
    """

    frame_index: IntArray
    timestamp_ns: IntArray
    object_id: IntArray
    class_names: Sequence[str]
    boxes: FloatArray
    frame_id: str
    image_boxes: FloatArray
    truncation: FloatArray
    occlusion: IntArray


@dataclass(frozen=True)
class CameraCalibration:
    """The camera that image boxes refer to.

    Attributes:
        image_from_sensor: `(3, 4)`, homogeneous points of the sensor frame to pixels.
        image_width_px: width of its images.
        image_height_px: height of its images.
        frame_id: name of the sensor frame.
    """

    image_from_sensor: FloatArray
    image_width_px: int
    image_height_px: int
    frame_id: str

    def to_json(self) -> dict[str, Any]:
        """The content of calibration.json (docs/formats.md)."""
        return {**vars(self), "image_from_sensor": self.image_from_sensor.tolist()}


@dataclass
class Findings:
    """What was odd in a sequence; complete once its last frame has been read."""

    problems: list[str] = field(default_factory=list)
    partial: bool = False

    def note(self, problem: str) -> None:
        """Record something odd that cost no data."""
        self.problems.append(problem)

    def lost(self, problem: str) -> None:
        """Record that data of the source could not be read."""
        self.problems.append(problem)
        self.partial = True


@dataclass(frozen=True)
class SequenceReading:
    """A sequence being read.

    Attributes:
        frames: all frames in time order, read as they are asked for.
        labels: None when the source has none.
        calibration: None when the source has none.
        findings: grows while frames are read.
    """

    frames: Iterator[Frame]
    labels: Labels | None
    calibration: CameraCalibration | None
    findings: Findings


class SequenceHandle(Protocol):
    """One sequence of a source."""

    @property
    def sequence_id(self) -> str:
        """Name of the sequence, safe as a file name."""
        ...

    def fingerprint(self) -> str:
        """Hash of everything that reading depends on; equal content, equal fingerprint.

        Raises:
            SourceError: something is missing.
            OSError: a file is unreadable.
        """
        ...

    def read(self) -> SequenceReading:
        """Start to read.

        Raises:
            SourceError: here or while frames are drawn; the message names the file and line.
            OSError: a file is unreadable.
        """
        ...


class Source(Protocol):
    """A log or folder that holds sequences."""

    @property
    def path(self) -> Path:
        """The file or folder as given."""
        ...

    @property
    def format_name(self) -> str:
        """Name of the format, for the catalogue."""
        ...

    def sequences(self) -> Sequence[SequenceHandle]:
        """Its sequences, in order.

        Raises:
            SourceError: it holds none.
            OSError: a file is unreadable.
        """
        ...


@contextmanager
def source_errors(path: Path) -> Iterator[None]:
    """Turn what the file system refuses while a source is read into one clear error.

    Raises:
        SourceError: names the file, or `path` where the system does not say which.
    """
    try:
        yield
    except OSError as error:
        raise SourceError(
            f"{error.filename or path}: cannot be read ({error.strerror or error}). "
            "Check that it is there and readable."
        ) from error


def no_image_boxes(count: int) -> FloatArray:
    """Image boxes of detections that have none."""
    return np.full((count, 4), np.nan)


def flat_boxes(boxes: FloatArray) -> NDArray[np.bool_]:
    """Rows whose box has a size of zero or less, `(n,)`."""
    smallest: FloatArray = boxes[:, LENGTH : HEIGHT + 1].min(axis=1)
    return smallest <= 0
