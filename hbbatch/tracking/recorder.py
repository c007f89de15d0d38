"""Collects what each step says about each track, and hands it out sequence by sequence."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.tracks import SequenceTracks


class StepRecord(NamedTuple):
    """Boxes said in one step; `boxes` and `velocity` may still be on the device."""

    sequence: IntArray
    frame_index: IntArray
    track_id: IntArray
    class_code: IntArray
    state: NDArray[np.int8]
    score: NDArray[np.float64]
    detection_row: IntArray
    boxes: Tensor
    velocity: Tensor


class Recorder:
    """Steps since the last hand-out, and the parts of sequences that are not finished."""

    def __init__(self) -> None:
        """Nothing recorded yet."""
        self._steps: list[StepRecord] = []
        self._parts: dict[int, list[SequenceTracks]] = {}

    def add(self, record: StepRecord) -> None:
        """Record a step. Nothing is copied or synchronised here."""
        self._steps.append(record)

    def finish(self, sequence: int) -> SequenceTracks:
        """All boxes of a finished sequence, sorted by frame and track; they are forgotten here."""
        self._distribute()
        return _concatenate(self._parts.pop(sequence, []))

    def _distribute(self) -> None:
        if not self._steps:
            return
        host = [np.concatenate(column) for column in list(zip(*self._steps, strict=True))[:7]]
        boxes = torch.cat([step.boxes for step in self._steps]).cpu().numpy()
        velocity = torch.cat([step.velocity for step in self._steps]).cpu().double().numpy()
        self._steps.clear()
        sequence, frame_index, track_id, class_code, state, score, detection_row = host
        tracks = SequenceTracks(
            frame_index, track_id, class_code, state, score, boxes, velocity, detection_row
        )
        for number in np.unique(sequence):
            part = tracks.take(np.flatnonzero(sequence == number))
            self._parts.setdefault(int(number), []).append(part)


def _concatenate(parts: list[SequenceTracks]) -> SequenceTracks:
    if not parts:
        return SequenceTracks.empty()
    joined = SequenceTracks(
        *(
            np.concatenate(columns)
            for columns in zip(*(vars(p).values() for p in parts), strict=True)
        )
    )
    return joined.take(np.lexsort((joined.track_id, joined.frame_index)))
