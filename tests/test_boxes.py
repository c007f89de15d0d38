"""Rotations against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hbbatch.boxes import rotation_matrices


def test_rotation_matrices_of_quaternions_of_any_length() -> None:
    quaternions = np.random.default_rng(0).normal(size=(50, 4))
    expected = Rotation.from_quat(quaternions).as_matrix()
    assert rotation_matrices(quaternions) == pytest.approx(expected, abs=1e-12)
    assert rotation_matrices(quaternions[:0]).shape == (0, 3, 3)
