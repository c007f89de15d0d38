"""The tracker a worker holds: settings, a motion filter on a device, class names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hbbatch.config import TrackSettings
from hbbatch.model.weights_files import WeightsFile, open_weights
from hbbatch.packed import kernels
from hbbatch.tracking.compiled_steps import compiled_steps
from hbbatch.tracking.frames import SequenceFrames
from hbbatch.tracking.lockstep import LockStep
from hbbatch.tracking.pieces import cut, joined
from hbbatch.tracking.refine import refine
from hbbatch.tracking.schedule import schedule
from hbbatch.tracking.steps import MakeSteps
from hbbatch.tracking.tracks import TrackedSequence


class Tracker:
    """Loaded once per worker, used for any number of groups."""

    def __init__(self, settings: TrackSettings, device: str = "cpu") -> None:
        """Load the weights the settings name.

        Args:
            settings: everything that decides the tracks.
            device: "cpu", or another one by torch's name.

        Raises:
            WeightsError: weights are missing, damaged or of another version.
        """
        self.settings = settings
        file = open_weights(settings.filter, settings.weights, settings.classes)
        self.class_names = file.class_names
        self.weights_hash = file.content_hash
        self._kinds = np.array(file.kind_codes)
        self._make_steps = stepping(file, device)

    def track(self, group: Sequence[SequenceFrames]) -> Iterator[TrackedSequence]:
        """Step all sequences of a group together; each is yielded when its last frame is done."""
        pieces = cut(group, self.settings.management)
        plan = schedule([piece.frames for piece in pieces])
        steps = self._make_steps(plan, self._kinds[plan.class_codes], self.settings)
        for number, tracks, seconds in joined(pieces, LockStep(plan, steps).run()):
            frames = group[number]
            done = refine(tracks, frames, self.settings.output, self.class_names)
            yield replace(done, seconds=seconds)


def stepping(file: WeightsFile, device: str) -> MakeSteps:
    """On a CPU the compiled steps, where they were built; else those of the torch modules."""
    if device == "cpu" and kernels.AVAILABLE:
        return compiled_steps(file)
    from hbbatch.tracking.eager_steps import eager_steps  # torch, which a CPU does without

    return eager_steps(file, device)
