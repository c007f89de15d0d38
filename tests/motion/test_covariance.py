"""Closed forms against plain matrices."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from hbbatch.model.blocks import Blocks
from hbbatch.motion import covariance as cov


def random_covariance(order: int, rng: np.random.Generator) -> np.ndarray:
    root = rng.normal(size=(order, order))
    return root @ root.T + 0.1 * np.eye(order)


def as_blocks(matrix: np.ndarray) -> Blocks:
    return {
        (i, j): torch.tensor([[matrix[i, j]]], dtype=torch.float64)
        for i, j in cov.pairs(len(matrix))
    }


def as_matrix(blocks: Blocks, order: int) -> np.ndarray:
    return np.array(
        [[blocks[min(i, j), max(i, j)].item() for j in range(order)] for i in range(order)]
    )


def transition(order: int, dt: float) -> np.ndarray:
    matrix = np.eye(order)
    matrix[0, 1] = dt
    if order == 3:
        matrix[0, 2], matrix[1, 2] = dt * dt / 2, dt
    return matrix


@pytest.mark.parametrize("order", [2, 3])
def test_propagation_is_f_p_f_transposed_plus_q(order: int) -> None:
    before, dt, density = random_covariance(order, np.random.default_rng(order)), 0.3, 2.0
    after = cov.propagate(
        as_blocks(before), torch.tensor([[density]]).double(), torch.tensor([[dt]]).double()
    )
    f = transition(order, dt)
    noise = np.array(
        [
            [
                density
                * quad(lambda t, i=i, j=j: (transition(order, t)[:, -1][[i, j]]).prod(), 0, dt)[0]
                for j in range(order)
            ]
            for i in range(order)
        ]
    )
    assert as_matrix(after, order) == pytest.approx(f @ before @ f.T + noise)


@pytest.mark.parametrize("order", [2, 3])
def test_correction_is_the_textbook_kalman_update(order: int) -> None:
    before, variance = random_covariance(order, np.random.default_rng(order)), 0.7
    gains, after = cov.correct(as_blocks(before), torch.tensor([[variance]]).double())
    h = np.eye(order)[:1]
    gain = before @ h.T / (h @ before @ h.T + variance)
    assert [g.item() for g in gains] == pytest.approx(gain[:, 0])
    assert as_matrix(after, order) == pytest.approx(before - gain @ h @ before)
