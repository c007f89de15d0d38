"""Steps of the ego vehicle that stick out."""

from __future__ import annotations

import numpy as np

from hbbatch.runner.ego_steps import jumps_problem

FRAMES = 100
STAMPS_NS = np.arange(FRAMES) * 100_000_000


def braking_in_a_turn() -> np.ndarray:
    """From 20 m/s at 6 m/s² to a stop, on a circle of 30 m."""
    seconds = np.minimum(STAMPS_NS / 1e9, 20 / 6)
    metres = 20 * seconds - 3 * seconds**2
    angle = metres / 30
    return np.stack([30 * np.sin(angle), 30 - 30 * np.cos(angle), 0 * angle], axis=1)


def test_hard_driving_is_no_jump() -> None:
    assert jumps_problem(braking_in_a_turn(), STAMPS_NS) is None


def test_a_correction_of_the_receiver_is_named_with_its_frame() -> None:
    path = braking_in_a_turn()
    path[40:] += (0.0, 0.3, 0.4)
    path[60:] += (0.2, 0.0, 0.0)
    problem = jumps_problem(path, STAMPS_NS)
    assert problem is not None
    assert problem.startswith("ego pose jumps at frames 40 (by up to 0.5")


def test_a_correction_over_many_frames_is_named_where_it_sets_in() -> None:
    """The receiver of a car that stands walks off by 2 m, ever slower."""
    path = braking_in_a_turn()
    path[60:, 1] += 2 * (1 - np.exp(-np.arange(1, FRAMES - 59) / 6))
    problem = jumps_problem(path, STAMPS_NS)
    assert problem is not None
    assert problem.startswith("ego pose jumps at frames 60 (by up to 0.3")


def test_a_missing_frame_is_no_jump() -> None:
    kept = np.delete(np.arange(FRAMES), [30])
    assert jumps_problem(braking_in_a_turn()[kept], STAMPS_NS[kept]) is None


def test_many_are_counted() -> None:
    path = braking_in_a_turn()
    path[10::7, 2] += 5.0
    problem = jumps_problem(path, STAMPS_NS)
    assert problem is not None
    assert "more (by up to 5." in problem


def test_too_few_frames_say_nothing() -> None:
    assert jumps_problem(np.zeros((0, 3)), STAMPS_NS[:0]) is None
    assert jumps_problem(100 * braking_in_a_turn()[:5], STAMPS_NS[:5]) is None
