"""How sequences are dealt to workers, so that the last of them is done soonest.

What a group costs is told from its frames and detections by a model of what was measured: a step
has a price whatever is in it, so have a detection and a sequence (docs/performance.md). Only the
ratios of the prices matter, and they change little from one machine to another.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from hbbatch.tracking.lanes import DETECTIONS_PER_STEP

MAX_GROUP_DETECTIONS: Final = 1_200_000
"""Detections handed to a worker at a time: some seven seconds of work, so that workers end
together and little is lost with one that dies."""

MAX_PART_DETECTIONS: Final = 300_000
"""Detections stepped together: some 150 MB of arrays; as many may be read meanwhile."""

_STEP_US: Final = 10
_DETECTION_US: Final = 4
_SEQUENCE_US: Final = 5_000

_WORKER_US: Final = 30_000
"""From the start of a worker that is forked to its first sequence. One that loads its modules
itself takes ten times as long, which small work on other systems than Linux is not spared."""

_REST: Final = 0.2
"""Part of the work that is kept for who is free first: more than prices err between groups."""

_LEAST_REST_US: Final = 130_000
"""What is handed out last at least: workers end so far apart, and smaller groups waste steps."""

_WORTH: Final = 1.05
"""How much more all groups together may cost for workers to end together."""


@dataclass(frozen=True)
class SequenceJob:
    """A sequence to track: what it was made of, the key its outputs will carry, and its size."""

    sequence_id: str
    source_hash: str
    key: str
    frames: int
    detections: int


Group = tuple[SequenceJob, ...]
"""Sequences that one worker steps together."""


def deal(jobs: Sequence[SequenceJob], workers: int) -> list[Group]:
    """Groups for workers that finish together, those that take longest first.

    A step costs the same whether one sequence of the group has a frame in it or all of them, so
    sequences of like length belong together: sorted by length they are cut where the effort of the
    largest group is least. They stay one group where starting workers would take longer, and are
    one a worker where there is little work, unless memory asks for more. Of much work the shortest
    sequences are kept back in smaller groups, for the workers that are free first: prices err, and
    so do cores.
    """
    ordered = sorted(jobs, key=lambda job: (-job.frames, -job.detections, job.sequence_id))
    if not ordered:
        return []
    groups = _even(ordered, workers)
    if max(map(_effort_us, groups)) + _WORKER_US > _effort_us(ordered):
        groups = [tuple(ordered)]
    else:
        groups = _with_rest(ordered, workers) or groups
    parts = [part for group in groups for part in bounded(group, MAX_GROUP_DETECTIONS)]
    return sorted(parts, key=_effort_us, reverse=True)


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


def _with_rest(ordered: Sequence[SequenceJob], workers: int) -> list[Group]:
    """Most of the work in a group a worker, the rest in smaller ones; none where that is no use."""
    rest_us = _REST * _effort_us(ordered)
    if workers == 1 or rest_us < workers * _LEAST_REST_US:
        return []
    kept = len(_first(ordered[::-1], rest_us))
    groups = [*_even(ordered[:-kept], workers), *_smaller_and_smaller(ordered[-kept:], workers)]
    even_us = sum(map(_effort_us, _even(ordered, workers)))
    return groups if sum(map(_effort_us, groups)) <= _WORTH * even_us else []


def _smaller_and_smaller(rest: Sequence[SequenceJob], workers: int) -> Iterator[Group]:
    """Each group half of what is left for each worker, so that the last are small."""
    while rest:
        group = _first(rest, max(_effort_us(rest) / (2 * workers), _LEAST_REST_US))
        yield group
        rest = rest[len(group) :]


def _even(ordered: Sequence[SequenceJob], workers: int) -> list[Group]:
    """No more groups than workers, the largest of which takes the least effort there is.

    To a thousandth of the whole.
    """
    too_little_us, enough_us = 0, _effort_us(ordered)
    near_us = enough_us // 1000 + 1
    groups = [tuple(ordered)]
    while enough_us - too_little_us > near_us:
        limit_us = (enough_us + too_little_us) // 2
        cut = list(_cut(ordered, limit_us))
        if len(cut) <= workers:
            enough_us, groups = limit_us, cut
        else:
            too_little_us = limit_us
    return groups


def _cut(ordered: Sequence[SequenceJob], limit_us: float) -> Iterator[Group]:
    """Neighbours together as long as their effort stays within a limit (or is one sequence's)."""
    while ordered:
        group = _first(ordered, limit_us)
        yield group
        ordered = ordered[len(group) :]


def _first(ordered: Sequence[SequenceJob], limit_us: float) -> Group:
    """The first sequences whose effort stays within a limit, one at least."""
    for number, effort_us in enumerate(_running_effort_us(ordered)):
        if number and effort_us > limit_us:
            return tuple(ordered[:number])
    return tuple(ordered)


def _effort_us(group: Sequence[SequenceJob]) -> int:
    """What a group costs, the longest sequence of which comes first."""
    return max(_running_effort_us(group), default=0)


def _running_effort_us(group: Sequence[SequenceJob]) -> Iterator[int]:
    """What the sequences so far cost a worker that takes them in parts, one value a sequence."""
    effort_us = of_parts_before_us = sequences = detections = longest = 0
    for job in group:
        if sequences and detections + job.detections > MAX_PART_DETECTIONS:
            of_parts_before_us, sequences, detections, longest = effort_us, 0, 0, 0
        sequences += 1
        detections += job.detections
        longest = max(longest, job.frames)
        steps = max(longest, detections // DETECTIONS_PER_STEP)
        of_part_us = _STEP_US * steps + _DETECTION_US * detections + _SEQUENCE_US * sequences
        effort_us = of_parts_before_us + of_part_us
        yield effort_us
