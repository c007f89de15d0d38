"""Covariance blocks (`hbbatch.motion.covariance`) as tensors `(n, axes)`, and as flat rows."""

from __future__ import annotations

import torch
from torch import Tensor

from hbbatch.motion.covariance import pairs

Blocks = dict[tuple[int, int], Tensor]


def blocks(flat: Tensor, order: int, axes: int) -> Blocks:
    """Views on the blocks of a flat `(n, axes · order · (order + 1) / 2)` covariance."""
    return {
        pair: flat[:, number * axes : (number + 1) * axes]
        for number, pair in enumerate(pairs(order))
    }


def join(covariance: Blocks) -> Tensor:
    """The flat matrix of the blocks."""
    return torch.cat(list(covariance.values()), dim=1)


def initial(variances: list[Tensor]) -> Blocks:
    """Uncorrelated covariance with the given variance `(n, axes)` for each derivative."""
    zero = torch.zeros_like(variances[0])
    return {(i, j): variances[i] if i == j else zero for i, j in pairs(len(variances))}
