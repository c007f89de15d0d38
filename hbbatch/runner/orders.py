"""What workers are told, and what they answer.

Small and picklable, and light to load: who gives orders needs nothing of what carries them out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from hbbatch.config import DeviceName, TrackSettings
from hbbatch.dataset import Dataset, Run
from hbbatch.runner.device import resolved_device
from hbbatch.runner.timing import TimingRow

if TYPE_CHECKING:
    from hbbatch.tracking.frames import SequenceFrames
    from hbbatch.tracking.tracks import TrackedSequence


class BatchTracker(Protocol):
    """The part of `tracking.engine.Tracker` that a worker uses."""

    class_names: tuple[str, ...]

    def track(self, group: Sequence[SequenceFrames]) -> Iterator[TrackedSequence]:
        """Step all sequences of a group together; each is yielded when it is done."""


@dataclass(frozen=True)
class LoadedTracker:
    """A tracker and the device it is on (cpu or cuda)."""

    tracker: BatchTracker
    device: str


LoadTracker = Callable[[TrackSettings, DeviceName], LoadedTracker]


@dataclass(frozen=True)
class Order:
    """What every worker of a run is told; small and picklable, heavy things are made from it."""

    dataset: Dataset
    run: Run
    settings: TrackSettings
    device: DeviceName
    load_tracker: LoadTracker
    recipe: str = ""
    """What the status files say that outputs were made with (`plan.recipe`)."""


@dataclass(frozen=True)
class Outcome:
    """What became of a sequence: a timing row when it is done, an error when it failed."""

    sequence_id: str
    timing: TimingRow | None = None
    error: str | None = None


def load_tracker(settings: TrackSettings, device: DeviceName) -> LoadedTracker:
    """The tracker on a device.

    Raises:
        UsageError: cuda is asked for and there is none.
        WeightsError: the weights are missing, damaged or of another version.
    """
    from hbbatch.tracking.engine import Tracker

    resolved = resolved_device(device)
    return LoadedTracker(Tracker(settings, resolved), resolved)
