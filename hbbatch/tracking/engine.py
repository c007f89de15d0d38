"""Many sequences in lock step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch

from hbbatch.config import TrackSettings
from hbbatch.tracking.frames import SequenceFrames
from hbbatch.tracking.tracks import TrackedSequence


class Tracker:
    """Loaded once per worker: filter weights on a device, class names, settings."""

    class_names: tuple[str, ...]
    weights_hash: str

    def __init__(self, settings: TrackSettings, device: torch.device) -> None:
        raise NotImplementedError

    def track(self, group: Sequence[SequenceFrames]) -> Iterator[TrackedSequence]:
        """Step all sequences of a group together; each is yielded when its last frame is done."""
        raise NotImplementedError
