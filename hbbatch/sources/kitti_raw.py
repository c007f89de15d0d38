"""KITTI raw drives: oxts with time stamps, calibration of the day, and detections beside them.

<date>/calib_cam_to_cam.txt, calib_velo_to_cam.txt, calib_imu_to_velo.txt
<date>/<drive>/oxts/data/0000000000.txt, oxts/timestamps.txt

Source: Geiger et al., "Vision meets robotics: The KITTI dataset", IJRR 2013, and its development
kit. Boxes are in the rectified camera-0 frame, as those of the tracking benchmark.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np

from hbbatch.dataset.store import safe_name
from hbbatch.errors import SourceError
from hbbatch.sources.base import (
    LOGGED,
    CameraCalibration,
    Description,
    Findings,
    IntArray,
    Names,
    Poses,
    SequenceReading,
    SourceOptions,
    TopicDescription,
)
from hbbatch.sources.kitti_detections import detection_files, frame_batch, read_detections
from hbbatch.sources.kitti_geometry import (
    SENSOR_FRAME,
    KittiCalibration,
    imu_poses,
    matrix_of,
    rigid_of,
    world_from_sensor,
)
from hbbatch.sources.kitti_text import line_error, parse_oxts, read_text

_CALIBRATION: Final = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt")
_REMEDY: Final = "Restore the file from its origin."


def is_kitti_raw_drive(path: Path) -> bool:
    """Whether a path is a folder that looks like a drive of the KITTI raw data."""
    return (path / "oxts" / "timestamps.txt").is_file() and (path / "oxts" / "data").is_dir()


@dataclass(frozen=True)
class KittiRawSource:
    """A drive of the KITTI raw data; it is one sequence, named after its folder."""

    path: Path
    options: SourceOptions
    format_name: str = "kitti_raw"

    @property
    def uses(self) -> Sequence[str]:
        """Detections lie apart from the drives."""
        return ("detections",)

    def sequences(self) -> Sequence[KittiRawSequence]:
        """The drive.

        Raises:
            SourceError: there are no detections for it.
        """
        asked_for = self.options.detections
        beside = (self.path / "detections", self.path.parent / "detections")
        folders = (asked_for,) if asked_for else beside
        for folder in folders:
            if folder.is_dir() and detection_files(folder, self.path.resolve().name):
                return [KittiRawSequence(self.path, folder)]
        named = ", ".join(str(folder) for folder in folders)
        raise SourceError(
            f"{self.path}: no detections ({self.path.resolve().name}.txt, or a folder of that "
            f"name, in {named}). Use --detections DIR."
        )

    def describe(self) -> Description:
        """Its frames; detections are looked for and not read."""
        drive = KittiRawSequence(self.path, self.path)
        stamps_ns = drive.stamps_ns()
        try:
            would = f"ingest it as {self.sequences()[0].sequence_id}"
        except SourceError as error:
            would = f"refuse: {error}"
        count = len(stamps_ns)
        span_s = (int(stamps_ns[-1]) - int(stamps_ns[0])) / 1e9 if count > 1 else 0.0
        rate_hz = (count - 1) / span_s if span_s > 0 else None
        topic = TopicDescription("oxts", "", "text", count, rate_hz, "poses")
        return Description(
            path=self.path,
            format_name=self.format_name,
            profile="",
            start_ns=int(stamps_ns[0]) if count else None,
            end_ns=int(stamps_ns[-1]) if count else None,
            messages=count,
            topics=[topic],
            frames=(),
            would=would,
            findings=Findings(),
        )


@dataclass(frozen=True)
class KittiRawSequence:
    """One drive."""

    root: Path
    detections: Path

    @property
    def sequence_id(self) -> str:
        """Name of its folder."""
        return safe_name(self.root.resolve().name)

    def fingerprint(self) -> str:
        """Hash of all its text files."""
        digest = hashlib.sha256()
        calibration = [self.root.resolve().parent / name for name in _CALIBRATION]
        stamps = self.root / "oxts" / "timestamps.txt"
        for path in [*calibration, stamps, *self._oxts_files(), *self._detection_files()]:
            content = read_text(path).encode()
            digest.update(f"{path.name} {len(content)}\n".encode())
            digest.update(content)
        return digest.hexdigest()

    def read(self) -> list[SequenceReading]:
        """Parse all its files; they are small. There is one sequence."""
        calibration = self._calibration()
        stamps_ns = self.stamps_ns()
        files = self._oxts_files()
        if len(files) != len(stamps_ns) or not files:
            raise SourceError(
                f"{self.root}/oxts: {len(files)} files in data, {len(stamps_ns)} lines in "
                f"timestamps.txt. {_REMEDY}"
            )
        oxts = np.concatenate([parse_oxts(path) for path in files])
        if len(oxts) != len(files):
            raise SourceError(f"{self.root}/oxts/data: not one line a file. {_REMEDY}")
        detections = read_detections(self._detection_files(), self.sequence_id)
        if detections.frames_needed > len(files):
            raise SourceError(
                f"{self.detections}: detections up to frame {detections.frames_needed - 1}, the "
                f"drive {self.sequence_id} has {len(files)} frames. Check that they belong to it."
            )
        poses = Poses(
            *world_from_sensor(imu_poses(oxts), calibration), Names.of([LOGGED] * len(files))
        )
        batch = frame_batch(detections, stamps_ns, poses)
        camera = CameraCalibration(
            calibration.image_from_sensor, *self._image_size_px(), SENSOR_FRAME
        )
        return [SequenceReading(self.sequence_id, iter([batch]), None, camera, Findings())]

    def stamps_ns(self) -> IntArray:
        """Times of its frames."""
        path = self.root / "oxts" / "timestamps.txt"
        lines = [line.strip() for line in read_text(path).splitlines() if line.strip()]
        return np.array([_stamp_ns(path, n, line) for n, line in enumerate(lines)], dtype=np.int64)

    def _oxts_files(self) -> list[Path]:
        return sorted((self.root / "oxts" / "data").glob("*.txt"))

    def _detection_files(self) -> list[Path]:
        return detection_files(self.detections, self.root.resolve().name)

    def _calibration(self) -> KittiCalibration:
        folder = self.root.resolve().parent
        cameras, velodyne, imu = (_Values(folder / name) for name in _CALIBRATION)
        return KittiCalibration(
            folder,
            {
                "P2": cameras.matrix("P_rect_02"),
                "R0_rect": cameras.rotation("R_rect_00"),
                "Tr_velo_to_cam": velodyne.rigid(),
                "Tr_imu_to_velo": imu.rigid(),
            },
        )

    def _image_size_px(self) -> tuple[int, int]:
        path = self.root.resolve().parent / _CALIBRATION[0]
        width, height = _Values(path).numbers("S_rect_02", 2)
        return int(float(width)), int(float(height))


class _Values:
    """A calibration file: `key: numbers` lines."""

    def __init__(self, path: Path) -> None:
        self._path = path
        parts = [line.partition(":") for line in read_text(path).splitlines()]
        self._lines = {key.strip(): (n, rest) for n, (key, _, rest) in enumerate(parts)}

    def numbers(self, key: str, count: int) -> list[str]:
        line, rest = self._lines.get(key, (0, ""))
        texts = rest.split()
        if len(texts) != count:
            raise line_error(self._path, line, f"{key} should be {count} numbers")
        return texts

    def matrix(self, key: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        line, rest = self._lines.get(key, (0, ""))
        return matrix_of(self._path, line, key, rest.split())

    def rotation(self, key: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        line, rest = self._lines.get(key, (0, ""))
        return rigid_of(self._path, line, key, rest.split())

    def rigid(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        turn, move = self.numbers("R", 9), self.numbers("T", 3)
        rows = [[*turn[3 * row : 3 * row + 3], move[row]] for row in range(3)]
        line = self._lines["R"][0]
        return rigid_of(self._path, line, "R and T", [text for row in rows for text in row])


def _stamp_ns(path: Path, line: int, text: str) -> int:
    """A time such as `2011-09-26 13:02:25.594360375`, taken as UTC."""
    whole, _, fraction = text.partition(".")
    try:
        moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
        return int(moment.timestamp()) * 10**9 + int(f"{fraction:0<9}"[:9])
    except ValueError as error:
        raise line_error(
            path, line, f"{text!r} is no time such as 2011-09-26 13:02:25.5"
        ) from error
