"""Covariance blocks as tensors."""

from __future__ import annotations

import torch

from hbbatch.model.blocks import blocks, join


def test_blocks_survive_the_flat_form() -> None:
    flat = torch.arange(2 * 24.0).reshape(2, 24)
    assert torch.equal(join(blocks(flat, 3, 4)), flat)
