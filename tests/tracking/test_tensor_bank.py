"""The tensor bank: what it asks of a device, checked without one."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch._subclasses.fake_tensor import FakeTensorMode

from hbbatch.config import TrackSettings
from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter
from hbbatch.tracking import tensor_bank as bank_module
from hbbatch.tracking.eager_steps import EagerSteps
from hbbatch.tracking.lockstep import LockStep
from hbbatch.tracking.schedule import Schedule, schedule
from hbbatch.tracking.tensor_bank import ROW_PADDING, TensorBank
from tests.tracking.drives import passing_cars

GPU = torch.device("meta")
"""Stands for a GPU: under fake tensors any mix of it with the host's tensors is an error."""

KINDS = ("vehicle", "pedestrian", "cyclist")


def no_kinds(plan: Schedule) -> np.ndarray:
    """All detections are of the first kind."""
    return np.zeros(len(plan.scores), np.int64)


def lock_step(plan: Schedule, bank: TensorBank) -> LockStep:
    return LockStep(plan, EagerSteps(bank, plan, no_kinds(plan), TrackSettings()))


@pytest.fixture
def fetched(monkeypatch: pytest.MonkeyPatch) -> list[Tensor]:
    """What came to the host from fake tensors, which know device and shape but hold nothing."""
    tensors: list[Tensor] = []

    def to_host(tensor: Tensor) -> np.ndarray:
        assert tensor.device == GPU
        tensors.append(tensor)
        values = np.zeros(tuple(tensor.shape))
        if tensor.shape[-1] == 7:
            values[:, :2] = 30.0 * np.arange(len(values))[:, None]
            values[:, 3:6] = 2.0
        return values

    monkeypatch.setattr(bank_module, "to_host", to_host)
    return tensors


@pytest.mark.parametrize("make", [KalmanFilter, HybridFilter])
@torch.no_grad()
def test_on_a_gpu_nothing_mixes_devices_and_the_host_waits_once_a_step(
    make: type[nn.Module], fetched: list[Tensor]
) -> None:
    plan = schedule([passing_cars(seed, frames=12, name=str(seed)) for seed in range(2)])
    motion = make(KINDS, "ct").to(GPU)
    with FakeTensorMode(allow_non_fake_inputs=True):
        bank = TensorBank(motion, plan, no_kinds(plan), GPU)  # type: ignore[arg-type]
        finished = [number for number, _, _ in lock_step(plan, bank).run()]
    assert sorted(finished) == [0, 1]
    # Priors of every step but the first, and what was said of each sequence.
    assert len(fetched) == plan.steps - 1 + 2


@torch.no_grad()
def test_a_tensor_left_on_the_host_fails(fetched: list[Tensor]) -> None:
    """The test above would see a mistake."""
    plan = schedule([passing_cars(0, frames=3)])
    motion = KalmanFilter(KINDS, "ct").to(GPU)
    motion.log_q_size = nn.Parameter(torch.zeros(3, 3))
    with FakeTensorMode(allow_non_fake_inputs=True):
        bank = TensorBank(motion, plan, no_kinds(plan), GPU)
        with pytest.raises(RuntimeError, match="same device"):
            list(lock_step(plan, bank).run())
    assert not fetched


def test_rows_are_padded_so_that_a_device_sees_few_shapes() -> None:
    shapes = set()

    class Watching(KalmanFilter):
        def predict(self, boxes: Tensor, rows: Tensor, dt_s: Tensor) -> tuple[Tensor, Tensor]:
            shapes.add(len(rows))
            return super().predict(boxes, rows, dt_s)

    plan = schedule([passing_cars(seed, frames=30, name=str(seed)) for seed in range(3)])
    with torch.inference_mode():
        bank = TensorBank(Watching(KINDS), plan, no_kinds(plan), torch.device("cpu"))
        list(lock_step(plan, bank).run())
    assert shapes <= {ROW_PADDING, 2 * ROW_PADDING}
