"""What every reader gives: sequences, each a stream of frames with boxes and the sensor's pose.

A reader of another format is a new file with a `Source` in it and one line in `detect.py`.
Handles of sequences are light and picklable; nothing is read before `fingerprint` or `read`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.errors import SourceError

IntArray = NDArray[np.int64]

LOGGED: Final = "logged"
INTERPOLATED: Final = "interpolated"
IDENTITY: Final = "identity"
POSE_ORIGINS: Final = (LOGGED, INTERPOLATED, IDENTITY)
"""How a pose was obtained, the most trustworthy first."""


@dataclass(frozen=True)
class SourceOptions:
    """What the user may say about sources; `Source.uses` says what concerns one.

    Attributes:
        detections: folder of detection files, for formats that keep them apart from the log.
        topics: detection topics to read, for logs; empty: the only one there is.
        world_frame: the world to give poses in, for logs; None: found by `transforms.WORLD_FRAMES`.
        pose_topic: the topic to take poses from, for logs; None: found by `log_poses`.
        max_gap_s: a longer time without a frame starts a new sequence; None: what a tracker with
            default settings bridges (`gaps.threshold_ns`).
        mappings: files that say how to read message types of one's own (`mapping`).
        message_paths: folders of .msg files, for logs without definitions.
        ros_distro: release whose definitions count for logs without definitions.
        classes: file that extends the table of class names (`classes`).
    """

    detections: Path | None = None
    topics: tuple[str, ...] = ()
    world_frame: str | None = None
    pose_topic: str | None = None
    max_gap_s: float | None = None
    mappings: tuple[Path, ...] = ()
    message_paths: tuple[Path, ...] = ()
    ros_distro: str | None = None
    classes: Path | None = None


@dataclass(frozen=True)
class Names:
    """n names, each spelled once.

    Attributes:
        codes: `(n,)` index into the vocabulary.
        vocabulary: the spellings.
    """

    codes: IntArray
    vocabulary: tuple[str, ...]

    @classmethod
    def of(cls, names: Sequence[str]) -> Names:
        """From a plain list."""
        numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
        codes = np.array([numbers[name] for name in names], dtype=np.int64)
        return cls(codes, tuple(numbers))

    def __getitem__(self, rows: IntArray | slice) -> Names:
        return Names(self.codes[rows], self.vocabulary)

    def to_list(self) -> list[str]:
        """As a plain list."""
        return [self.vocabulary[code] for code in self.codes.tolist()]


@dataclass(frozen=True)
class Poses:
    """world_from_sensor of m frames.

    Attributes:
        translation_m: `(m, 3)`.
        rotation: `(m, 4)` unit quaternions x, y, z, w.
        origins: m of `POSE_ORIGINS`.
    """

    translation_m: FloatArray
    rotation: FloatArray
    origins: Names

    @classmethod
    def identity(cls, count: int) -> Poses:
        """Where nothing is known."""
        rotation = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
        return cls(np.zeros((count, 3)), rotation, Names.of([IDENTITY] * count))

    def __len__(self) -> int:
        return len(self.translation_m)

    def __getitem__(self, rows: IntArray | slice) -> Poses:
        return Poses(self.translation_m[rows], self.rotation[rows], self.origins[rows])


@dataclass(frozen=True)
class FrameBatch:
    """Consecutive frames of a sequence: what was detected, and where the sensor was.

    Attributes:
        timestamp_ns: `(m,)` header stamps, since the Unix epoch.
        log_time_ns: `(m,)` when the recorder received them, None when the source does not say.
        frame_ids: names of the sensor frames that the boxes are in, m of them.
        poses: of those sensors in the world, at the stamps.
        box_counts: `(m,)` boxes of each frame; the boxes of all frames follow one another.
        boxes: `(n, 7)` in the sensor frame, convention of `hbbatch.boxes`.
        scores: `(n,)` as logged.
        class_names: n names as the source wrote them.
        image_boxes: `(n, 4)` left, top, right, bottom in pixels, NaN where there is none.
        source_rows: `(n,)` line or message number it was read from, from 0.
    """

    timestamp_ns: IntArray
    log_time_ns: IntArray | None
    frame_ids: Names
    poses: Poses
    box_counts: IntArray
    boxes: FloatArray
    scores: FloatArray
    class_names: Names
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


def _one_line(text: str) -> str:
    """Libraries quote what they could not read, line breaks included."""
    return " ".join(text.split())


@dataclass
class Findings:
    """What was odd in a sequence; complete once its last frame has been read.

    Attributes:
        problems: one line each.
        partial: whether data of the source could not be read.
        messages_read: messages that its containers hold, of all topics.
        messages_expected: messages that its containers say they hold, None when they do not.
    """

    problems: list[str] = field(default_factory=list)
    partial: bool = False
    messages_read: int = 0
    messages_expected: int | None = None

    def note(self, problem: str) -> None:
        """Record something odd that cost no data."""
        self.problems.append(_one_line(problem))

    def lost(self, problem: str) -> None:
        """Record that data of the source could not be read."""
        self.problems.append(_one_line(problem))
        self.partial = True

    def adopt(self, other: Findings, where: str) -> None:
        """Take over what was found in a part of the source."""
        self.problems += [f"{where}: {problem}" for problem in other.problems]
        self.partial |= other.partial
        self.messages_read += other.messages_read


@dataclass(frozen=True)
class SequenceReading:
    """A sequence being read.

    Attributes:
        sequence_id: name of the sequence, safe as a file name.
        batches: all frames in time order, read as they are asked for.
        labels: None when the source has none.
        calibration: None when the source has none.
        findings: grows while frames are read.
    """

    sequence_id: str
    batches: Iterator[FrameBatch]
    labels: Labels | None
    calibration: CameraCalibration | None
    findings: Findings


class SequenceHandle(Protocol):
    """One recording of a source: a sequence, or several where it pauses for long."""

    @property
    def sequence_id(self) -> str:
        """Name of the sequence, safe as a file name; of several, what their names begin with."""
        ...

    def fingerprint(self) -> str:
        """Hash of everything that reading depends on; equal content, equal fingerprint.

        Raises:
            SourceError: something is missing.
            OSError: a file is unreadable.
        """
        ...

    def read(self) -> Sequence[SequenceReading]:
        """Start to read; several sequences are to be drawn in order.

        Raises:
            SourceError: here or while frames are drawn; the message names the file and line.
            OSError: a file is unreadable.
        """
        ...


@dataclass(frozen=True)
class TopicDescription:
    """A topic of a source.

    Attributes:
        topic: its name.
        message_type: as `package/msg/Type`, empty when the source does not say.
        encoding: of messages and definition, such as `cdr/ros2msg`.
        messages: how many there are.
        rate_hz: messages a second between its first and last, None with less than two.
        holds: detections, transforms, poses or nothing (empty).
        problem: why its messages cannot be decoded, empty when they can or need not be.
    """

    topic: str
    message_type: str
    encoding: str
    messages: int
    rate_hz: float | None
    holds: str
    problem: str = ""


@dataclass(frozen=True)
class Description:
    """What a source holds.

    Attributes:
        path: the file or folder.
        format_name: name of the format.
        profile: what it says of the system it was recorded on, empty when nothing.
        start_ns: first log time, None when there is none.
        end_ns: last log time.
        messages: how many there are.
        topics: sorted by name.
        frames: names of the frames of the transform tree, each with its parent: `child < parent`.
        would: what ingest would do with it, one line.
        findings: what was odd, and what it declares to hold.
    """

    path: Path
    format_name: str
    profile: str
    start_ns: int | None
    end_ns: int | None
    messages: int
    topics: Sequence[TopicDescription]
    frames: Sequence[str]
    would: str
    findings: Findings

    @property
    def duration_s(self) -> float:
        """Last minus first log time."""
        if self.start_ns is None or self.end_ns is None:
            return 0.0
        return (self.end_ns - self.start_ns) / 1e9

    @property
    def rate_hz(self) -> float | None:
        """Messages a second between the first and the last, None with less than two."""
        return (self.messages - 1) / self.duration_s if self.duration_s > 0 else None


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

    @property
    def uses(self) -> Collection[str]:
        """Which fields of `SourceOptions` concern it."""
        ...

    def sequences(self) -> Sequence[SequenceHandle]:
        """Its sequences, in order.

        Raises:
            SourceError: it holds none.
            OSError: a file is unreadable.
        """
        ...

    def describe(self) -> Description:
        """What it holds; all of it is read, nothing is written.

        Raises:
            SourceError: something is missing.
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
    """Image boxes of detections that have none; one number, seen from everywhere."""
    return np.broadcast_to(np.nan, (count, 4))
