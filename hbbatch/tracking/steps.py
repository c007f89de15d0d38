"""What takes the tracks of a group from step to step, whatever computes it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from hbbatch.config import TrackSettings
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.recorder import Recorder, Said
from hbbatch.tracking.schedule import Schedule
from hbbatch.tracking.tracks import StageSeconds


class Steps(Protocol):
    """The live tracks of a group and what was said of them.

    In each step all tracks are predicted, associated with detections of their own block and
    corrected; matched tracks are recorded, and coasting ones where that is asked for; tracks that
    missed too often are dropped, and detections that continue none begin one.

    Attributes:
        recorder: what was said, but boxes and velocities.
    """

    recorder: Recorder

    @property
    def predicted(self) -> int:
        """Track steps predicted so far."""

    @property
    def corrected(self) -> int:
        """Track steps corrected by a detection so far."""

    def run(self, start: int, stop: int) -> StageSeconds:
        """Do the steps from start to before stop, which follow those done; what each stage took."""

    def end(self, sequence: int) -> None:
        """Drop the tracks of a sequence."""

    def said(self, places: IntArray) -> Said:
        """What was said in these places."""


MakeSteps = Callable[[Schedule, IntArray, TrackSettings], Steps]
"""Steps of a group without tracks, given its timetable, the kind code `(n,)` of each detection and
the settings of the run."""


def blocks(plan: Schedule, kinds: IntArray) -> IntArray:
    """`(n,)` block of each detection: tracks match those of their own sequence and kind only."""
    block: IntArray = plan.sequence * (int(kinds.max(initial=0)) + 1) + kinds
    return block


def most_coasted(settings: TrackSettings) -> int:
    """Up to how many misses a coasting track is said."""
    output = settings.output
    return output.max_coasted if output.protocol == "online" else 0
