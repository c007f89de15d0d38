"""The same outcomes in this process and in others, and workers that die."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from hbbatch.config import TrackSettings
from hbbatch.dataset import Dataset
from hbbatch.errors import HbbatchError, WeightsError
from hbbatch.runner.dealing import Group, SequenceJob
from hbbatch.runner.executors import Executor, ProcessExecutor, SerialExecutor, _Worker
from hbbatch.runner.orders import LoadTracker, Order, Outcome
from hbbatch.runner.processes import Cores, WorkerProcess
from tests.runner.small_dataset import (
    load_breaks,
    load_echo,
    load_fails,
    load_says_cores,
    make_dataset,
)


def order(dataset: Dataset, run: str = "r", load: LoadTracker = load_echo) -> Order:
    return Order(dataset, dataset.run(run), TrackSettings(), "cpu", load)


def group(*sequence_ids: str) -> Group:
    return tuple(SequenceJob(i, "source", "key", 3, 6) for i in sequence_ids)


def errors(outcomes: list[Outcome]) -> dict[str, str | None]:
    return {outcome.sequence_id: outcome.error for outcome in outcomes}


def test_processes_write_the_same_as_this_process(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b", "c")
    groups = [group("a", "b"), group("c")]
    for executor, run in ((SerialExecutor(), "one"), (ProcessExecutor(2), "two")):
        outcomes = list(executor.run(order(dataset, run), groups))
        assert errors(outcomes) == {"a": None, "b": None, "c": None}
    for sequence_id in "abc":
        one, two = dataset.run("one"), dataset.run("two")
        assert one.kitti(sequence_id).read_bytes() == two.kitti(sequence_id).read_bytes()
        assert one.read_tracks(sequence_id).equals(two.read_tracks(sequence_id))


def test_a_killed_worker_loses_its_group_only(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "kills", "b", "c")
    groups = [group("a", "kills"), group("b"), group("c")]
    found = errors(list(ProcessExecutor(1).run(order(dataset), groups)))
    assert found["b"] is None
    assert found["c"] is None
    for sequence_id in ("a", "kills"):
        assert "worker process was killed (out of memory?)" in str(found[sequence_id])


def test_all_workers_are_started_before_one_is_told_anything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is loading does not listen yet, and what does not fit its pipe would hold up all."""
    events = []
    start, hire = WorkerProcess.start, _Worker.hire

    def started() -> WorkerProcess:
        events.append("started")
        return start()

    def hired(worker: _Worker, order: Order, cores: Cores) -> None:
        events.append("hired")
        hire(worker, order, cores)

    monkeypatch.setattr(WorkerProcess, "start", started)
    monkeypatch.setattr(_Worker, "hire", hired)
    dataset = make_dataset(tmp_path, "a", "b")
    list(ProcessExecutor(2).run(order(dataset), [group("a"), group("b")]))
    assert events == ["started", "started", "hired", "hired"]


@pytest.fixture
def two_cores() -> Iterator[set[int]]:
    """This process and those it starts may use two cores."""
    if not hasattr(os, "sched_setaffinity"):
        pytest.skip("this system keeps no process to a core")
    before = os.sched_getaffinity(0)
    two = set(sorted(before)[:2])
    os.sched_setaffinity(0, two)
    yield two
    os.sched_setaffinity(0, before)


def test_workers_that_leave_no_core_free_keep_to_one_each(
    tmp_path: Path, two_cores: set[int]
) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    asked = order(dataset, load=load_says_cores)
    alone = list(ProcessExecutor(1).run(asked, [group("a", "b")]))
    assert {cores_of(outcome) for outcome in alone} == {tuple(sorted(two_cores))}
    beside_another = list(ProcessExecutor(2).run(asked, [group("a"), group("b")]))
    assert {cores_of(outcome) for outcome in beside_another} == {(core,) for core in two_cores}


def cores_of(outcome: Outcome) -> tuple[int, ...]:
    assert outcome.timing
    return tuple(json.loads(outcome.timing["device"]))


@pytest.mark.parametrize("executor", [SerialExecutor(), ProcessExecutor(2)])
def test_weights_that_do_not_load_stop_the_run(tmp_path: Path, executor: Executor) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    with pytest.raises(WeightsError, match="of another version"):
        list(executor.run(order(dataset, load=load_fails), [group("a"), group("b")]))


def test_a_worker_that_cannot_start_says_why(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a")
    with pytest.raises(HbbatchError, match=r"cannot start \(ImportError: no module named magic\)"):
        list(ProcessExecutor(1).run(order(dataset, load=load_breaks), [group("a")]))


def test_stopping_early_ends_the_workers_and_keeps_what_is_done(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "sleeps")
    outcomes = ProcessExecutor(2).run(order(dataset), [group("a"), group("sleeps")])
    assert next(outcomes).sequence_id == "a"
    outcomes.close()
    assert dataset.run("r").status("a").is_file()
    assert not dataset.run("r").status("sleeps").exists()
    assert not list(tmp_path.rglob("*.partial"))
