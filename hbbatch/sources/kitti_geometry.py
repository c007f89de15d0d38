"""Frames of the KITTI recording car: calibration, ego poses, and its boxes in our convention.

KITTI logs boxes in the rectified camera-0 frame: x right, y down, z forward, (x, y, z) the bottom
centre, `ry` about y with heading (cos ry, 0, -sin ry). Here a sensor frame has z up, so the sensor
frame of a KITTI sequence is that camera frame with its axes permuted: x forward (camera z), y left
(minus camera x), z up (minus camera y). Nothing is lost or rounded by it.

Source: Geiger et al., "Vision meets robotics: The KITTI dataset", IJRR 2013, and the development
kit of the raw data (Mercator projection of the oxts records).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from hbbatch.boxes import FloatArray, wrap_angle
from hbbatch.errors import SourceError
from hbbatch.sources.kitti_text import read_text

SENSOR_FRAME: Final = "camera0_rect_flu"
_EARTH_RADIUS_M: Final = 6378137.0
_EVEN_FRAMES: Final = 5.0
"""Standard deviation, in frames, of the window that positions are evened over."""

_LARGEST_MISFIT_M: Final = 0.1
"""Median difference, a frame, of distance and speed at which speeds are not believed."""

_MOST_EVENED_M: Final = 0.25
"""How far a position is moved at most: 5 ms at 50 m/s. More is a jump, or a speed that is wrong."""

_MISFIT: Final = 0.01
"""How far products of a rotation's rows may be from those of the axes, for rounded numbers."""

_LARGEST_SHIFT_M: Final = 100.0
_CAMERA_FROM_FLU: Final[FloatArray] = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
_KEYS: Final = {
    "P2": "P2",
    "R0_rect": "R0_rect",
    "R_rect": "R0_rect",
    "Tr_velo_to_cam": "Tr_velo_to_cam",
    "Tr_velo_cam": "Tr_velo_to_cam",
    "Tr_imu_to_velo": "Tr_imu_to_velo",
    "Tr_imu_velo": "Tr_imu_to_velo",
}
"""The spellings of KITTI's benchmarks, with or without a colon behind."""


@dataclass(frozen=True)
class KittiCalibration:
    """A calib file; matrices are padded to `(4, 4)`."""

    path: Path
    matrices: dict[str, FloatArray]

    def __getitem__(self, name: str) -> FloatArray:
        if name not in self.matrices:
            raise SourceError(f"{self.path}: {name} is missing. Restore the file from its origin.")
        return self.matrices[name]

    @property
    def image_from_sensor(self) -> FloatArray:
        """Points of the sensor frame to pixels of camera 2, `(3, 4)`; boxes are rectified."""
        return self["P2"][:3] @ _CAMERA_FROM_FLU

    @property
    def imu_from_sensor(self) -> FloatArray:
        """Points of the sensor frame to the IMU frame, `(4, 4)`."""
        camera_from_imu = self["R0_rect"] @ self["Tr_velo_to_cam"] @ self["Tr_imu_to_velo"]
        imu_from_sensor: FloatArray = np.linalg.inv(camera_from_imu) @ _CAMERA_FROM_FLU
        return imu_from_sensor


def read_calibration(path: Path) -> KittiCalibration:
    """A KITTI calib file, in the spelling of any of its benchmarks.

    Raises:
        SourceError: the file is missing, a matrix that is needed has not 9 or 12 numbers, or one
            that should be rigid is not.
    """
    matrices = {}
    for number, line in enumerate(read_text(path).splitlines()):
        key, *texts = line.replace(":", " ", 1).split() or [""]
        if key in _KEYS:
            read = matrix_of if _KEYS[key] == "P2" else rigid_of
            matrices[_KEYS[key]] = read(path, number, key, texts)
    return KittiCalibration(path, matrices)


def matrix_of(path: Path, line: int, key: str, texts: list[str]) -> FloatArray:
    """A matrix of 9 or 12 numbers, padded to `(4, 4)`.

    Raises:
        SourceError: they are not, naming file, line and key.
    """
    try:
        values = np.array([float(text) for text in texts])
    except ValueError:
        values = np.array([])
    if values.size not in (9, 12) or not np.isfinite(values).all():
        raise SourceError(
            f"{path}:{line + 1}: {key} should be 9 or 12 numbers. Restore the file from its origin."
        )
    padded = np.eye(4)
    padded[:3, : values.size // 3] = values.reshape(3, -1)
    return padded


def rigid_of(path: Path, line: int, key: str, texts: list[str]) -> FloatArray:
    """A rotation of 9 numbers, or with a shift of 12, padded to `(4, 4)`.

    Raises:
        SourceError: they are not, naming file, line and key.
    """
    matrix = matrix_of(path, line, key, texts)
    turn, shift_m = matrix[:3, :3], matrix[:3, 3]
    is_small = (np.abs(turn) < 2).all() and (np.abs(shift_m) < _LARGEST_SHIFT_M).all()
    is_turn = (
        is_small and np.allclose(turn @ turn.T, np.eye(3), atol=_MISFIT) and np.linalg.det(turn) > 0
    )
    if not is_turn:
        raise SourceError(
            f"{path}:{line + 1}: {key} is no rotation, or shifts by more than a vehicle is long. "
            "Restore the file from its origin."
        )
    return matrix


def sensor_boxes(camera_boxes: FloatArray) -> FloatArray:
    """KITTI boxes in our convention.

    Args:
        camera_boxes: `(n, 7)` height, width, length, x, y, z, ry.

    Returns:
        `(n, 7)` in the sensor frame.
    """
    height, width, length, x, y, z, ry = camera_boxes.T
    yaw = wrap_angle(-ry - np.pi / 2)
    return np.stack([z, -x, -y + height / 2, length, width, height, yaw], axis=1)


def imu_poses(oxts: FloatArray) -> FloatArray:
    """world_from_imu `(n, 4, 4)`; the world is the IMU frame of the first line.

    Args:
        oxts: `(n, 6)` or wider: latitude, longitude (degrees), altitude (m), roll, pitch, yaw
            (rad).
    """
    mercator_from_imu = _mercator_from_imu(oxts)
    world_from_imu: FloatArray = np.linalg.inv(mercator_from_imu[0]) @ mercator_from_imu
    return world_from_imu


def evened(world_from_imu: FloatArray, forward_m_s: FloatArray, frame_s: float) -> FloatArray:
    """The same poses as if the receiver had been read at an even rate.

    KITTI's tracking benchmark gives with each frame the record nearest in time, up to 5 ms off: at
    25 m/s an eighth of a metre along the way, which all objects of a frame then seem to jump. The
    receiver's own speed tells how far the car went in a frame, and what the positions say beyond
    that is smoothed. Poses are left alone where speeds and positions do not fit together.

    Args:
        world_from_imu: `(n, 4, 4)`.
        forward_m_s: `(n,)` speed along the IMU's first axis.
        frame_s: time between frames.
    """
    forward = world_from_imu[:, :3, 0]
    step_m = (np.diff(world_from_imu[:, :3, 3], axis=0) * forward[:-1]).sum(axis=1)
    driven_m = (forward_m_s[:-1] + forward_m_s[1:]) * (0.5 * frame_s)
    if not len(step_m) or np.median(np.abs(step_m - driven_m)) > _LARGEST_MISFIT_M:
        return world_from_imu
    ahead_m = np.concatenate([[0.0], np.cumsum(step_m - driven_m)])
    uneven_m = ahead_m - gaussian_filter1d(ahead_m, _EVEN_FRAMES, mode="nearest")
    uneven_m = np.clip(uneven_m, -_MOST_EVENED_M, _MOST_EVENED_M)
    poses = world_from_imu.copy()
    poses[:, :3, 3] -= uneven_m[:, None] * forward
    return poses


def world_from_sensor(
    world_from_imu: FloatArray, calibration: KittiCalibration
) -> tuple[FloatArray, FloatArray]:
    """Poses of the sensor: translations (m) `(n, 3)`, unit quaternions x, y, z, w `(n, 4)`."""
    poses = world_from_imu @ calibration.imu_from_sensor
    return poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat()


def _mercator_from_imu(oxts: FloatArray) -> FloatArray:
    latitude, longitude = np.radians(oxts[:, 0]), np.radians(oxts[:, 1])
    scale_m = np.cos(latitude[0]) * _EARTH_RADIUS_M
    poses = np.tile(np.eye(4), (len(oxts), 1, 1))
    poses[:, 0, 3] = scale_m * longitude
    poses[:, 1, 3] = scale_m * np.log(np.tan(np.pi / 4 + latitude / 2))
    poses[:, 2, 3] = oxts[:, 2]
    poses[:, :3, :3] = Rotation.from_euler("xyz", oxts[:, 3:6]).as_matrix()
    return poses
