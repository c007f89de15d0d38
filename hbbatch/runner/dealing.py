"""How sequences are dealt to workers, so that the last of them is done soonest.

What a group costs is told from its frames and detections by a model of what was measured: a step
has a price whatever is in it, so have a detection and a sequence (docs/performance.md). Only the
ratios of the prices matter, and they change little from one machine to another.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from hbbatch.tracking.schedule import DETECTIONS_PER_STEP

MAX_GROUP_DETECTIONS: Final = 1_200_000
"""Detections handed to a worker at a time: a quarter of a minute's work, so that workers end
together and little is lost with one that dies."""

MAX_PART_DETECTIONS: Final = 300_000
"""Detections stepped together: some 150 MB of arrays; as many may be read meanwhile."""

_STEP_US: Final = 220
_DETECTION_US: Final = 8
_SEQUENCE_US: Final = 8_000

_WORKER_US: Final = 350_000
"""From the start of a worker process to its first sequence."""


@dataclass(frozen=True)
class SequenceJob:
    """A sequence to track, its size, and the key its outputs will carry."""

    sequence_id: str
    key: str
    frames: int
    detections: int


Group = tuple[SequenceJob, ...]
"""Sequences that one worker steps together."""


def deal(jobs: Sequence[SequenceJob], workers: int) -> list[Group]:
    """Groups for workers that finish together, at most one a worker unless memory asks for more.

    A step costs the same whether one sequence of the group has a frame in it or all of them, so
    sequences of like length belong together: sorted by length they are cut where the effort of the
    largest group is least. They stay one group where starting workers would take longer.
    """
    ordered = sorted(jobs, key=lambda job: (-job.frames, -job.detections, job.sequence_id))
    if not ordered:
        return []
    whole_us = _effort_us(ordered)
    groups = _cut(ordered, _least_limit_us(ordered, workers, whole_us))
    if max(map(_effort_us, groups)) + _WORKER_US > whole_us:
        groups = [tuple(ordered)]
    return [part for group in groups for part in bounded(group, MAX_GROUP_DETECTIONS)]


def bounded(group: Group, max_detections: int) -> Iterator[Group]:
    """The group in parts of at most so many detections (or of one sequence)."""
    part: list[SequenceJob] = []
    held = 0
    for job in group:
        if part and held + job.detections > max_detections:
            yield tuple(part)
            part, held = [], 0
        part.append(job)
        held += job.detections
    if part:
        yield tuple(part)


def _least_limit_us(ordered: Sequence[SequenceJob], workers: int, enough_us: int) -> int:
    """The least effort within which no more groups than workers can be kept."""
    too_little_us = 0
    while enough_us - too_little_us > 1:
        limit_us = (enough_us + too_little_us) // 2
        if len(_cut(ordered, limit_us)) <= workers:
            enough_us = limit_us
        else:
            too_little_us = limit_us
    return enough_us


def _cut(ordered: Sequence[SequenceJob], limit_us: int) -> list[Group]:
    """Neighbours together as long as their effort stays within a limit (or is one sequence's)."""
    groups: list[list[SequenceJob]] = []
    effort = _Effort()
    for job in ordered:
        grown = effort.with_job(job)
        if groups and grown.total_us <= limit_us:
            groups[-1].append(job)
            effort = grown
        else:
            groups.append([job])
            effort = _Effort().with_job(job)
    return [tuple(group) for group in groups]


def _effort_us(group: Sequence[SequenceJob]) -> int:
    effort = _Effort()
    for job in group:
        effort = effort.with_job(job)
    return effort.total_us


@dataclass(frozen=True)
class _Effort:
    """What a group costs that a worker takes in parts.

    Attributes:
        full_us: of the parts before the last.
        sequences, detections: of the last part.
        longest: frames of its longest sequence, which comes first.
    """

    full_us: int = 0
    sequences: int = 0
    detections: int = 0
    longest: int = 0

    def with_job(self, job: SequenceJob) -> _Effort:
        """With a sequence more."""
        detections = self.detections + job.detections
        if self.sequences and detections > MAX_PART_DETECTIONS:
            return _Effort(self.total_us, 1, job.detections, job.frames)
        longest = max(self.longest, job.frames)
        return _Effort(self.full_us, self.sequences + 1, detections, longest)

    @property
    def total_us(self) -> int:
        """Of all parts."""
        steps = max(self.longest, self.detections // DETECTIONS_PER_STEP)
        last_us = _STEP_US * steps + _DETECTION_US * self.detections
        return self.full_us + last_us + _SEQUENCE_US * self.sequences
