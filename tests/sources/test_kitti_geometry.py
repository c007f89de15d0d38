"""Ego poses evened in time, by the speed that the receiver itself measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hbbatch.sources.kitti_geometry import evened, imu_poses
from hbbatch.sources.kitti_text import OXTS_FORWARD, parse_oxts

FRAME_S = 0.1


def straight_drive(speed_m_s: np.ndarray, late_s: np.ndarray) -> np.ndarray:
    """Poses along x, each read `late_s` after its frame."""
    poses = np.tile(np.eye(4), (len(speed_m_s), 1, 1))
    start = np.concatenate([[0.0], np.cumsum((speed_m_s[1:] + speed_m_s[:-1]) / 2 * FRAME_S)])
    poses[:, 0, 3] = start + late_s * speed_m_s
    return poses


def test_what_uneven_reading_adds_is_taken_away() -> None:
    speed = np.linspace(5.0, 25.0, 200)
    late = np.random.default_rng(0).uniform(-0.005, 0.005, 200)
    uneven, exact = straight_drive(speed, late), straight_drive(speed, np.zeros(200))
    even = evened(uneven, speed, FRAME_S)
    error = np.diff(uneven[:, 0, 3] - exact[:, 0, 3]).std()
    left = np.diff(even[:, 0, 3] - exact[:, 0, 3]).std()
    assert left < 0.2 * error
    assert np.abs(even[:, 0, 3] - exact[:, 0, 3]).max() < 0.06


def test_sideways_and_upwards_nothing_moves() -> None:
    poses = straight_drive(np.full(50, 10.0), np.random.default_rng(1).normal(0, 0.003, 50))
    poses[:, 1, 3], poses[:, 2, 3] = np.arange(50) * 0.2, np.sin(np.arange(50))
    even = evened(poses, np.full(50, 10.0), FRAME_S)
    np.testing.assert_array_equal(even[:, 1:3, 3], poses[:, 1:3, 3])
    np.testing.assert_array_equal(even[:, :3, :3], poses[:, :3, :3])


@pytest.mark.parametrize("speed", [0.0, 30.0])
def test_speeds_that_do_not_fit_the_positions_are_not_believed(speed: float) -> None:
    poses = straight_drive(np.full(50, 10.0), np.zeros(50))
    assert evened(poses, np.full(50, speed), FRAME_S) is poses


def test_a_wrong_speed_or_a_jump_moves_no_position_far() -> None:
    speed = np.full(50, 10.0)
    poses = straight_drive(speed, np.zeros(50))
    spiked = np.where(np.arange(50) == 20, 500.0, speed)
    assert np.abs(evened(poses, spiked, FRAME_S) - poses).max() < 0.3
    poses[30:, 0, 3] += 40.0
    assert np.abs(evened(poses, speed, FRAME_S) - poses).max() < 0.3


def test_one_frame_needs_no_evening() -> None:
    assert len(evened(np.eye(4)[None], np.zeros(1), FRAME_S)) == 1


@pytest.mark.parametrize("sequence_id", ["0003", "0005", "0020"])
def test_real_drives_then_move_as_smoothly_as_they_did(test_data: Path, sequence_id: str) -> None:
    """Second differences of the way driven fall to a quarter."""
    oxts = parse_oxts(test_data / "kitti" / "training" / "oxts" / f"{sequence_id}.txt")
    logged = imu_poses(oxts)
    even = evened(logged, oxts[:, OXTS_FORWARD], FRAME_S)

    def roughness(poses: np.ndarray) -> float:
        way = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
        return float(np.abs(np.diff(way)).mean())

    assert roughness(even) < 0.25 * roughness(logged)
