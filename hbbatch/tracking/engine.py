"""The tracker a worker holds: settings, a motion filter on a device, class names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import torch

from hbbatch.config import TrackSettings
from hbbatch.model.packed_hybrid import packed
from hbbatch.model.weights import load_filter
from hbbatch.tracking.bank import FilterBank, TensorBank
from hbbatch.tracking.frames import SequenceFrames
from hbbatch.tracking.lockstep import LockStep
from hbbatch.tracking.packed_bank import PackedBank
from hbbatch.tracking.refine import refine
from hbbatch.tracking.schedule import Schedule, schedule
from hbbatch.tracking.tracks import TrackedSequence


class Tracker:
    """Loaded once per worker, used for any number of groups."""

    def __init__(self, settings: TrackSettings, device: torch.device) -> None:
        """Load the weights the settings name.

        Raises:
            WeightsError: weights are missing, damaged or of another version.
        """
        self.settings = settings
        self._device = device
        loaded = load_filter(settings.filter, settings.weights, settings.classes)
        self.class_names = loaded.class_names
        self.weights_hash = loaded.content_hash
        self._kinds = np.array(loaded.kind_codes)
        self._motion = loaded.motion.to(device).eval()

    @torch.inference_mode()
    def track(self, group: Sequence[SequenceFrames]) -> Iterator[TrackedSequence]:
        """Step all sequences of a group together; each is yielded when its last frame is done."""
        plan = schedule(group)
        lock_step = LockStep(plan, self._bank(plan), self._kinds, self.settings)
        for number, tracks, seconds in lock_step.run():
            frames = group[number]
            done = refine(tracks, frames, self.settings.output, self.class_names)
            yield replace(done, seconds=seconds)

    def _bank(self, plan: Schedule) -> FilterBank:
        """On a CPU the packed filter; the torch modules on any other device."""
        if self._device.type == "cpu":
            return PackedBank(packed(self._motion), plan, self._kinds[plan.class_codes])
        return TensorBank(self._motion, plan, self._device)
