"""Filter rows as tensors on any device, stepped by the filter's torch modules."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hbbatch.boxes import FloatArray
from hbbatch.model.filters import Measurement, MotionFilter
from hbbatch.model.weights import build_loaded
from hbbatch.model.weights_files import WeightsFile
from hbbatch.tracking.bank import MakeBank, Said
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.schedule import Schedule

ROW_PADDING: Final = 64
"""Tensors grow by so many rows at once, so that a device sees few different shapes."""

SAID_WIDTH: Final = 10
"""Numbers of a box and its velocity: both come to the host at once."""


def tensor_banks(file: WeightsFile, device: str) -> MakeBank:
    """Banks of the filter of a weights file, on a device; torch's host part runs in one thread.

    Raises:
        WeightsError: the file does not fit this version's filters.
    """
    torch.set_num_threads(1)
    where = torch.device(device)
    motion = build_loaded(file).to(where).eval()
    return lambda plan, kinds: TensorBank(motion, plan, kinds, where)


class TensorBank:
    """A `FilterBank` with a row a track.

    Rows are padded with copies of the first to a multiple of `ROW_PADDING`. The host waits for
    the device once a step, in `predict`, and once a finished sequence, in `said`.
    """

    @torch.inference_mode()
    def __init__(
        self, motion: MotionFilter, plan: Schedule, kinds: IntArray, device: torch.device
    ) -> None:
        """Stage the detections of a group on the device."""
        self._motion = motion
        self._device = device
        self._kinds = kinds
        self._dt_s = plan.dt_s
        self._measured = Measurement(
            to_device(plan.boxes, device),
            to_device(plan.sight_m.astype(np.float32), device),
            to_device(plan.scores.astype(np.float32), device),
        )
        self._boxes = torch.empty((0, 7), dtype=torch.float64, device=device)
        self._state = torch.empty((0, motion.width), dtype=torch.float32, device=device)
        self._count = 0
        self._said = torch.empty((len(plan.scores), SAID_WIDTH), dtype=torch.float64, device=device)

    @torch.inference_mode()
    def predict(self, frames: IntArray, damping: FloatArray | None) -> FloatArray:
        """See `FilterBank.predict`."""
        dt = to_device(_padded(self._dt_s[frames]), self._device)
        prior, self._state = self._motion.predict(self._boxes, self._state, dt)
        if damping is not None:
            share = to_device(_padded(damping), self._device)[:, None]
            prior[:, :3] = torch.lerp(self._boxes[:, :3], prior[:, :3], share)
        self._boxes = prior
        return to_host(prior[: self._count])

    @torch.inference_mode()
    def arrange(self, order: IntArray) -> None:
        """See `FilterBank.arrange`."""
        index = to_device(_padded(order), self._device)
        self._boxes = self._boxes.index_select(0, index)
        self._state = self._state.index_select(0, index)
        self._count = len(order)

    @torch.inference_mode()
    def update(self, detections: IntArray) -> None:
        """See `FilterBank.update`."""
        count = len(detections)
        seen = self._measurement(detections)
        padded = len(seen.boxes)
        boxes, state = self._motion.update(self._boxes[:padded], self._state[:padded], seen)
        self._boxes[:count] = boxes[:count]
        self._state[:count] = state[:count]

    @torch.inference_mode()
    def truncate(self, count: int) -> None:
        """See `FilterBank.truncate`."""
        if count < self._count:
            self.arrange(np.arange(count))

    @torch.inference_mode()
    def append(self, detections: IntArray) -> None:
        """See `FilterBank.append`."""
        seen = self._measurement(detections)
        born = self._motion.birth(seen, to_device(_padded(self._kinds[detections]), self._device))
        count = len(detections)
        self._boxes = torch.cat([self._boxes[: self._count], seen.boxes[:count]])
        self._state = torch.cat([self._state[: self._count], born[:count]])
        self.arrange(np.arange(self._count + count))

    @torch.inference_mode()
    def reserve(self, places: int) -> None:
        """See `FilterBank.reserve`."""
        if places > len(self._said):
            self._said = torch.cat([self._said, self._said.new_empty(places, SAID_WIDTH)])

    @torch.inference_mode()
    def say(self, rows: IntArray, places: IntArray) -> None:
        """See `FilterBank.say`."""
        where = to_device(rows, self._device)
        velocity = self._motion.velocity(self._state[where])
        said = torch.cat([self._boxes[where], velocity], dim=1)
        self._said.index_copy_(0, to_device(places, self._device), said)

    @torch.inference_mode()
    def said(self, places: IntArray) -> Said:
        """See `FilterBank.said`."""
        said = to_host(self._said.index_select(0, to_device(places, self._device)))
        return said[:, :7].copy(), said[:, 7:].copy()

    def _measurement(self, detections: IntArray) -> Measurement:
        index = to_device(_padded(detections), self._device)
        return Measurement(*(column.index_select(0, index) for column in self._measured))


def to_device(values: NDArray[np.generic], device: torch.device) -> Tensor:
    """Copy to the device without waiting for it, from pinned memory where that helps."""
    tensor = torch.from_numpy(np.ascontiguousarray(values))
    if device.type == "cuda":
        tensor = tensor.pin_memory()
    return tensor.to(device, non_blocking=True)


def to_host(tensor: Tensor) -> NDArray[np.float64]:
    """Copy to the host; this waits for the device."""
    values: NDArray[np.float64] = tensor.cpu().numpy()
    return values


def _padded(values: NDArray[Any]) -> NDArray[Any]:
    """Repeat the first value up to a multiple of `ROW_PADDING`."""
    missing = -len(values) % ROW_PADDING
    return np.concatenate([values, values[:1].repeat(missing)]) if missing else values
