"""KITTI tracking folders: calib, oxts, label_02, and detections beside them.

KITTI's tracking benchmark gives no time stamps; frames come at 10 Hz, so frame n is at n · 100 ms.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.errors import SourceChoiceError, SourceError
from hbbatch.sources.base import (
    LOGGED,
    CameraCalibration,
    Description,
    Findings,
    Labels,
    Names,
    Poses,
    SequenceReading,
    SourceOptions,
    TopicDescription,
)
from hbbatch.sources.kitti_detections import (
    KittiDetections,
    detected_sequences,
    detection_files,
    frame_batch,
    read_detections,
)
from hbbatch.sources.kitti_geometry import (
    SENSOR_FRAME,
    KittiCalibration,
    evened,
    imu_poses,
    read_calibration,
    world_from_sensor,
)
from hbbatch.sources.kitti_labels import FRAME_NS, read_labels
from hbbatch.sources.kitti_text import OXTS_FORWARD, parse_oxts

_PARTS: Final = ("calib", "oxts", "label_02", "image_02")
_DETECTION_FOLDERS: Final = ("det_02", "detections")
_IMAGE_SIZES_PX: Final = {
    721.5377: (1242, 375),
    718.856: (1241, 376),
    718.3351: (1238, 374),
    707.0493: (1224, 370),
    707.0912: (1226, 370),
}
"""Focal length of P2 to width and height: KITTI recorded on five days, each with its own crop."""


@dataclass(frozen=True)
class KittiSource:
    """A folder of the KITTI tracking benchmark, such as `training`."""

    path: Path
    options: SourceOptions
    format_name: str = "kitti_tracking"

    @property
    def uses(self) -> Sequence[str]:
        """Detections lie apart from the drives."""
        return ("detections",)

    def sequences(self) -> Sequence[KittiSequence]:
        """Every sequence that any part of the folder or, numbered, the detections know of."""
        folder = self._detections()
        in_parts = {e.stem for part in _PARTS for e in _entries(self.path / part)}
        detected = detected_sequences(folder)
        if not in_parts & detected:
            raise SourceError(
                f"{folder}: no detections for any sequence of {self.path}. Expected NNNN.txt or "
                "NNNN/FFFFFF.txt there, or both a class folder deeper; name the folder with "
                "--detections."
            )
        numbered = {sequence_id for sequence_id in detected if sequence_id.isdecimal()}
        return [KittiSequence(self.path, folder, i) for i in sorted(in_parts | numbered)]

    def describe(self) -> Description:
        """Its sequences as topics; nothing but the names of files is read."""
        try:
            names = [sequence.sequence_id for sequence in self.sequences()]
            would = f"ingest {len(names)} sequences: {', '.join(names)}"
        except SourceError as error:
            would = f"refuse: {error}"
        parts = [part for part in _PARTS if _entries(self.path / part)]
        topics = [
            TopicDescription(part, "", "text", len(_entries(self.path / part)), None, "")
            for part in parts
        ]
        return Description(
            self.path, self.format_name, "", None, None, 0, topics, (), would, Findings()
        )

    def _detections(self) -> Path:
        candidates = [self.path / name for name in _DETECTION_FOLDERS]
        if self.options.detections is not None:
            candidates = [self.options.detections]
            if not self.options.detections.is_dir():
                fault = "is no folder" if self.options.detections.exists() else "does not exist"
                raise SourceChoiceError(f"{self.options.detections}: {fault}. Check --detections.")
        for folder in candidates:
            if folder.is_dir():
                return folder
        named = ", ".join(str(folder) for folder in candidates)
        raise SourceError(f"{self.path}: no detections (no folder {named}). Use --detections DIR.")


def is_kitti_folder(path: Path) -> bool:
    """Whether a path is a folder that looks like one of the KITTI tracking benchmark."""
    return any(_entries(path / part) for part in _PARTS)


def _entries(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return [e for e in folder.iterdir() if e.suffix == ".txt" or e.stem.isdecimal()]


@dataclass(frozen=True)
class KittiSequence:
    """One sequence of a KITTI tracking folder."""

    root: Path
    detections: Path
    sequence_id: str

    def fingerprint(self) -> str:
        """Hash of all its text files, and of what is read from its images."""
        digest = hashlib.sha256(repr(self._images()).encode())
        for path in self._text_files():
            content = path.read_bytes()
            digest.update(f"{path.parent.name}/{path.name} {len(content)}\n".encode())
            digest.update(content)
        return digest.hexdigest()

    def read(self) -> list[SequenceReading]:
        """Parse all its files; they are small. There is one sequence."""
        findings = Findings()
        calibration = read_calibration(self._part("calib"))
        detections = read_detections(self._detection_files(), self.sequence_id)
        labels = read_labels(self._part("label_02")) if self._part("label_02").is_file() else None
        poses = self._poses(calibration, findings)
        frame_count = self._frame_count(detections, labels, len(poses))
        poses = poses if len(poses) else Poses.identity(frame_count)
        reading = SequenceReading(
            sequence_id=self.sequence_id,
            batches=iter([frame_batch(detections, np.arange(len(poses)) * FRAME_NS, poses)]),
            labels=labels,
            calibration=self._camera(calibration, detections, labels, findings),
            findings=findings,
        )
        return [reading]

    def _part(self, part: str) -> Path:
        return self.root / part / f"{self.sequence_id}.txt"

    def _detection_files(self) -> list[Path]:
        files = detection_files(self.detections, self.sequence_id)
        if not files:
            raise SourceError(
                f"sequence {self.sequence_id}: no detections in {self.detections}. Run the "
                "detector on it (a file of zero bytes says that nothing was found)."
            )
        return files

    def _text_files(self) -> list[Path]:
        parts = [self._part(part) for part in ("calib", "oxts", "label_02")]
        return [path for path in parts if path.is_file()] + self._detection_files()

    def _images(self) -> tuple[int, tuple[int, int] | None]:
        """How many images of camera 2 there are, and width and height of the first."""
        images = sorted((self.root / "image_02" / self.sequence_id).glob("*.png"))
        return len(images), _png_size(images[0]) if images else None

    def _poses(self, calibration: KittiCalibration, findings: Findings) -> Poses:
        """A pose a line of oxts; none without oxts."""
        path = self._part("oxts")
        if not path.is_file():
            findings.note("no oxts: no ego poses, identity recorded; tracks will be worse")
            return Poses.identity(0)
        oxts = parse_oxts(path)
        if not len(oxts):
            raise SourceError(f"{path}: holds no line. Restore the file from its origin.")
        world_from_imu = evened(imu_poses(oxts), oxts[:, OXTS_FORWARD], FRAME_NS * 1e-9)
        translations_m, rotations = world_from_sensor(world_from_imu, calibration)
        return Poses(translations_m, rotations, Names.of([LOGGED] * len(oxts)))

    def _frame_count(
        self, detections: KittiDetections, labels: Labels | None, oxts_lines: int
    ) -> int:
        """Lines of oxts; without oxts as many frames as anything else of the sequence needs."""
        images, _ = self._images()
        labelled = int(labels.frame_index.max(initial=-1)) + 1 if labels else 0
        needed = max(images, labelled, detections.frames_needed)
        if oxts_lines and oxts_lines < images:
            raise SourceError(
                f"{self._part('oxts')}: {oxts_lines} lines for {images} images. Restore the file "
                "from its origin, or remove it to go on without ego poses."
            )
        if oxts_lines and oxts_lines < needed:
            where = self._part("label_02") if labelled == needed else self._detection_files()[-1]
            raise SourceError(
                f"{where}: goes up to frame {needed - 1}, {self._part('oxts')} has {oxts_lines} "
                "lines, one a frame. Check that both are of the same sequence, and whole."
            )
        if not needed and not oxts_lines:
            raise SourceError(
                f"sequence {self.sequence_id}: no frames (no oxts, no images, no detections). "
                f"Restore {self._part('oxts')} from its origin."
            )
        return oxts_lines or needed

    def _camera(
        self,
        calibration: KittiCalibration,
        detections: KittiDetections,
        labels: Labels | None,
        findings: Findings,
    ) -> CameraCalibration | None:
        image_from_sensor = calibration.image_from_sensor
        _, size = self._images()
        size = size or _IMAGE_SIZES_PX.get(round(float(calibration["P2"][0, 0]), 4))
        if size is None:
            size = _largest_edges(detections.image_boxes, labels)
            findings.note(_guessed_size(size))
        if size is None:
            return None
        return CameraCalibration(image_from_sensor, *size, SENSOR_FRAME)


def _png_size(path: Path) -> tuple[int, int]:
    """Width and height in a PNG file's first chunk."""
    with path.open("rb") as file:
        head = file.read(24)
    if len(head) < 24 or head[:8] != b"\x89PNG\r\n\x1a\n":
        raise SourceError(f"{path}: is no PNG image. Restore it from its origin, or remove it.")
    width, height = struct.unpack(">II", head[16:24])
    return width, height


def _largest_edges(detected: FloatArray, labels: Labels | None) -> tuple[int, int] | None:
    boxes = detected if labels is None else np.concatenate([detected, labels.image_boxes])
    if np.isnan(boxes).all():
        return None
    return int(np.ceil(np.nanmax(boxes[:, 2]))), int(np.ceil(np.nanmax(boxes[:, 3])))


def _guessed_size(size: tuple[int, int] | None) -> str:
    unknown = "image size unknown (no image_02, focal length of none of KITTI's days)"
    if size is None:
        return f"{unknown}: no camera calibration recorded"
    return f"{unknown}: {size[0]} x {size[1]} px taken from the outermost image boxes"
