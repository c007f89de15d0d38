"""How sequences are dealt to workers."""

from __future__ import annotations

import heapq
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hbbatch.runner import dealing
from hbbatch.runner.dealing import Group, SequenceJob, deal

LONG = 100_000
"""Frames that are worth a worker's start."""


def jobs(*frames: int, detections: int = 1) -> list[SequenceJob]:
    return [SequenceJob(f"{i:04}", "source", "key", n, detections) for i, n in enumerate(frames)]


def test_each_worker_gets_one_group_of_like_lengths() -> None:
    groups = deal(jobs(1000, LONG, 900, 800, 700, 600, detections=9_000), workers=2)
    assert [[job.frames for job in group] for group in groups] == [
        [LONG],
        [1000, 900, 800, 700, 600],
    ]


def test_many_sequences_are_dealt_evenly() -> None:
    groups = deal(jobs(*[100] * 150, *[200] * 150, detections=500), workers=4)
    loads = [len(group) for group in groups]
    assert len(groups) == 4
    assert max(loads) < 1.1 * min(loads)


def test_little_work_is_left_to_one_worker() -> None:
    """It is done before a second one would have started."""
    assert len(deal(jobs(100, 90, 80), workers=2)) == 1
    assert len(deal(jobs(LONG, LONG), workers=1)) == 1


def test_work_that_does_not_divide_is_left_to_one_worker() -> None:
    """The longest sequence has its steps, and the others ride along for next to nothing."""
    assert len(deal(jobs(LONG, 20), workers=2)) == 1


def test_a_part_costs_its_longest_sequence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice the steps where memory cuts a group in two parts, so it is dealt in halves."""
    monkeypatch.setattr(dealing, "MAX_PART_DETECTIONS", 25)
    groups = deal(jobs(*[LONG] * 4, detections=10), workers=2)
    assert [len(group) for group in groups] == [2, 2]


def test_there_are_no_more_groups_than_sequences() -> None:
    assert len(deal(jobs(LONG, LONG), workers=8)) <= 2
    assert deal([], workers=8) == []


def test_a_group_too_large_for_memory_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dealing, "MAX_GROUP_DETECTIONS", 25)
    groups = deal(jobs(4, 3, 2, 1, detections=10), workers=1)
    assert [len(group) for group in groups] == [2, 2]
    assert [len(group) for group in deal(jobs(4, detections=99), workers=1)] == [1]


def test_much_work_is_dealt_but_for_the_shortest_sequences() -> None:
    """They are kept for who is free first, in groups that get smaller."""
    frames = [50 + n for n in range(1000)]
    groups = deal(jobs(*frames, detections=2000), workers=2)
    most, rest = groups[:2], groups[2:]
    assert 0.75 < sum(map(len, most)) / len(frames) < 0.85
    assert max(job.frames for group in rest for job in group) <= min(
        job.frames for group in most for job in group
    )
    sizes = [len(group) for group in groups]
    assert len(rest) > 4
    assert sizes[2:] == sorted(sizes[2:], reverse=True)
    assert 2 * sizes[-1] < sizes[2]


def makespan(groups: list[Group], workers: int, price: Callable[[SequenceJob], float]) -> float:
    """When the last worker is done if each takes the next group as soon as it is free."""
    free = [0.0] * workers
    for group in groups:
        heapq.heappush(free, heapq.heappop(free) + sum(map(price, group)))
    return max(free)


@pytest.mark.parametrize("workers", [2, 3, 8])
@pytest.mark.parametrize("error", [0.7, 1.35])
def test_workers_end_together_though_prices_err(workers: int, error: float) -> None:
    """What long sequences really take is another part of what short ones do."""
    dealt = jobs(*range(50, 450), *range(50, 450), *range(50, 450), detections=4000)

    def price(job: SequenceJob) -> float:
        return error if job.frames > 250 else 1.0

    even = sum(map(price, dealt)) / workers
    assert makespan(deal(dealt, workers), workers, price) < 1.05 * even


def test_long_sequences_are_not_kept_back() -> None:
    """Alone each would take the steps that they share in a group."""
    groups = deal(jobs(*[5 * LONG] * 8, detections=50_000), workers=2)
    assert [len(group) for group in groups] == [4, 4]


def test_what_takes_longest_is_dealt_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dealing, "MAX_GROUP_DETECTIONS", 250_000)
    groups = deal(jobs(*[100] * 40, detections=10_000), workers=2)
    sizes = [len(group) for group in groups]
    assert sizes == sorted(sizes, reverse=True)


@given(st.lists(st.integers(0, 50_000), max_size=40), st.integers(1, 9))
def test_every_sequence_is_dealt_once(frames: list[int], workers: int) -> None:
    groups = deal(jobs(*frames), workers)
    dealt = sorted(job.sequence_id for group in groups for job in group)
    assert dealt == [f"{i:04}" for i in range(len(frames))]
    assert all(groups)
    assert workers > 1 or len(groups) <= 1
