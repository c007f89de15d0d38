"""Filter rows as tensors on any device, stepped by the filter's torch modules.

Rows are in the order of the `RowTable`. After association the matched tracks are moved to the
front, so that the update works on a prefix and nothing is scattered.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hbbatch.boxes import FloatArray
from hbbatch.model.filters import Measurement, MotionFilter
from hbbatch.model.weights import build_loaded
from hbbatch.model.weights_files import WeightsFile
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.recorder import Said
from hbbatch.tracking.schedule import Schedule

ROW_PADDING: Final = 64
"""Tensors grow by so many rows at once, so that a device sees few different shapes."""

SAID_WIDTH: Final = 10
"""Numbers of a box and its velocity: both come to the host at once."""

MakeBank = Callable[[Schedule, IntArray], "TensorBank"]
"""A bank without rows, given a group's detections and the kind code `(n,)` of each."""


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
    """Boxes and filter state of the live tracks, a row each.

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
        """Take each row on to a frame `(n,)` of the group; their prior boxes `(n, 7)`.

        With `damping` `(n,)` given, centres move by that share of the predicted step.
        """
        dt = to_device(_padded(self._dt_s[frames]), self._device)
        prior, self._state = self._motion.predict(self._boxes, self._state, dt)
        if damping is not None:
            share = to_device(_padded(damping), self._device)[:, None]
            prior[:, :3] = torch.lerp(self._boxes[:, :3], prior[:, :3], share)
        self._boxes = prior
        return to_host(prior[: self._count])

    @torch.inference_mode()
    def arrange(self, order: IntArray) -> None:
        """Row `order[i]` becomes row i; rows not named are dropped."""
        index = to_device(_padded(order), self._device)
        self._boxes = self._boxes.index_select(0, index)
        self._state = self._state.index_select(0, index)
        self._count = len(order)

    @torch.inference_mode()
    def update(self, detections: IntArray) -> None:
        """Correct the first rows by these detections of the group."""
        count = len(detections)
        seen = self._measurement(detections)
        padded = len(seen.boxes)
        boxes, state = self._motion.update(self._boxes[:padded], self._state[:padded], seen)
        self._boxes[:count] = boxes[:count]
        self._state[:count] = state[:count]

    @torch.inference_mode()
    def truncate(self, count: int) -> None:
        """Drop all rows but the first."""
        if count < self._count:
            self.arrange(np.arange(count))

    @torch.inference_mode()
    def append(self, detections: IntArray) -> None:
        """Add rows born from detections of the group."""
        seen = self._measurement(detections)
        born = self._motion.birth(seen, to_device(_padded(self._kinds[detections]), self._device))
        count = len(detections)
        self._boxes = torch.cat([self._boxes[: self._count], seen.boxes[:count]])
        self._state = torch.cat([self._state[: self._count], born[:count]])
        self.arrange(np.arange(self._count + count))

    @torch.inference_mode()
    def reserve(self, places: int) -> None:
        """Have so many places, those of the group's detections counted."""
        if places > len(self._said):
            self._said = torch.cat([self._said, self._said.new_empty(places, SAID_WIDTH)])

    @torch.inference_mode()
    def say(self, rows: IntArray, places: IntArray) -> None:
        """Remember the boxes and velocities of some rows as they are now, each in its place.

        Places are the numbers of the group's detections, and those reserved after them.
        """
        where = to_device(rows, self._device)
        velocity = self._motion.velocity(self._state[where])
        said = torch.cat([self._boxes[where], velocity], dim=1)
        self._said.index_copy_(0, to_device(places, self._device), said)

    @torch.inference_mode()
    def said(self, places: IntArray) -> Said:
        """What was said in these places."""
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
