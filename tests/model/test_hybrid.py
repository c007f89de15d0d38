"""The learned filter's module: which kinds it learned."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hbbatch.model.filters import Measurement
from hbbatch.model.hybrid import HybridFilter

KINDS = ("vehicle", "pedestrian", "cyclist")
TRACKS = 20


def seen_near(rng: np.random.Generator, boxes: np.ndarray) -> Measurement:
    return Measurement(
        torch.from_numpy(boxes + rng.normal(0, 0.2, boxes.shape)),
        torch.from_numpy(rng.uniform(-40, 40, (TRACKS, 3))).float(),
        torch.zeros(TRACKS),
    )


@torch.inference_mode()
def test_kinds_that_are_not_learned_move_like_the_classical_base() -> None:
    rng = np.random.default_rng(1)
    torch.manual_seed(3)
    motion = HybridFilter(KINDS, "ct", learned=(True, False, True)).eval()
    for parameter in motion.parameters():
        parameter.add_(0.15 * torch.randn_like(parameter))
    seen = seen_near(rng, np.tile([5.0, 3.0, 1.0, 4.0, 2.0, 1.5, 0.3], (TRACKS, 1)))
    pedestrians = torch.ones(TRACKS, dtype=torch.long)
    boxes, rows = seen.boxes, motion.birth(seen, pedestrians)
    plain_boxes, plain_rows = boxes, motion.base.birth(seen, pedestrians)
    dt = torch.full((TRACKS,), 0.1)
    for _ in range(4):
        boxes, rows = motion.predict(boxes, rows, dt)
        plain_boxes, plain_rows = motion.base.predict(plain_boxes, plain_rows, dt)
        seen = seen_near(rng, plain_boxes.numpy())
        boxes, rows = motion.update(boxes, rows, seen)
        plain_boxes, plain_rows = motion.base.update(plain_boxes, plain_rows, seen)
    torch.testing.assert_close(boxes, plain_boxes, rtol=0, atol=1e-6)


def test_a_list_of_learned_kinds_of_another_length_is_refused() -> None:
    with pytest.raises(TypeError, match="learned has 1 entries for 3 kinds"):
        HybridFilter(KINDS, "ct", learned=(True,))
