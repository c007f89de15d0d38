"""The row table: a row per live track of any sequence of the group."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from hbbatch.tracking.frames import IntArray


class RowTable:
    """Struct of arrays: counters and identities on the host, boxes and filter state on the device.

    Attributes:
        sequence: `(n,)` number of the sequence in the group.
        track_id: `(n,)` identity within the sequence.
        class_code: `(n,)`.
        hits: `(n,)` matched detections, the first included.
        age: `(n,)` steps since birth.
        misses: `(n,)` consecutive steps without a detection.
        boxes: `(n, 7)` float64 posterior on the device.
        state: `(n, width)` float32 filter rows on the device.
    """

    def __init__(self, width: int, device: torch.device) -> None:
        """An empty table."""
        self.sequence: IntArray = np.empty(0, np.int64)
        self.track_id: IntArray = np.empty(0, np.int64)
        self.class_code: IntArray = np.empty(0, np.int64)
        self.hits: IntArray = np.empty(0, np.int64)
        self.age: IntArray = np.empty(0, np.int64)
        self.misses: IntArray = np.empty(0, np.int64)
        self.boxes = torch.empty((0, 7), dtype=torch.float64, device=device)
        self.state = torch.empty((0, width), dtype=torch.float32, device=device)

    def __len__(self) -> int:
        return len(self.sequence)

    def keep(self, rows: IntArray) -> None:
        """Drop all rows but these (ascending)."""
        if len(rows) == len(self):
            return
        self.sequence = self.sequence[rows]
        self.track_id = self.track_id[rows]
        self.class_code = self.class_code[rows]
        self.hits = self.hits[rows]
        self.age = self.age[rows]
        self.misses = self.misses[rows]
        index = torch.from_numpy(rows).to(self.boxes.device)
        self.boxes = self.boxes.index_select(0, index)
        self.state = self.state.index_select(0, index)

    def append(
        self,
        sequence: IntArray,
        track_id: IntArray,
        class_code: IntArray,
        boxes: Tensor,
        state: Tensor,
    ) -> None:
        """Add newborn tracks."""
        self.sequence = np.concatenate([self.sequence, sequence])
        self.track_id = np.concatenate([self.track_id, track_id])
        self.class_code = np.concatenate([self.class_code, class_code])
        self.hits = np.concatenate([self.hits, np.ones_like(sequence)])
        self.age = np.concatenate([self.age, np.zeros_like(sequence)])
        self.misses = np.concatenate([self.misses, np.zeros_like(sequence)])
        self.boxes = torch.cat([self.boxes, boxes])
        self.state = torch.cat([self.state, state])
