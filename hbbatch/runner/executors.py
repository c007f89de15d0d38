"""Where groups of sequences are tracked: in this process, or in worker processes beside it."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from typing import Protocol

from hbbatch.errors import HbbatchError
from hbbatch.runner.dealing import Group
from hbbatch.runner.orders import Order, Outcome
from hbbatch.runner.processes import Cores, WorkerProcess, cores_for


class Executor(Protocol):
    """Tracks groups of sequences somewhere."""

    def run(self, order: Order, groups: Sequence[Group]) -> Generator[Outcome, None, None]:
        """One outcome a sequence, in the order in which they end.

        Raises:
            HbbatchError: no worker can start (weights, device).
        """


class SerialExecutor:
    """One group after the other, in this process."""

    def run(self, order: Order, groups: Sequence[Group]) -> Generator[Outcome, None, None]:
        """See `Executor.run`."""
        # Not above: whose work is done by other processes loads nothing of it.
        from hbbatch.runner.worker import track_group

        loaded = order.load_tracker(order.settings, order.device)
        for group in groups:
            yield from track_group(order, loaded, group, worker=0)


class ProcessExecutor:
    """Groups in worker processes, each with its own tracker and its own pipe.

    A worker that dies takes only the unfinished sequences of its group with it: they come out as
    failed, and a fresh worker goes on with the groups that are left.
    """

    def __init__(self, workers: int) -> None:
        """Start no process yet, and no more than `workers` later."""
        self._workers = workers

    def run(self, order: Order, groups: Sequence[Group]) -> Generator[Outcome, None, None]:
        """See `Executor.run`."""
        queue = deque(groups)
        crew: dict[Connection, _Worker] = {}
        try:
            while queue or crew:
                for worker in self._hired(crew, len(queue)):
                    worker.hire(order, cores_for(worker.number, self._workers))
                    worker.give(queue)
                for pipe in wait(list(crew)):
                    yield from _hear(crew, queue, crew[pipe])  # type: ignore[index]
        finally:
            for worker in crew.values():
                worker.process.stop()

    def _hired(self, crew: dict[Connection, _Worker], groups: int) -> list[_Worker]:
        """Workers that join the crew, one a group as far as there is room.

        All are started before the first is talked to: one that is loading does not listen yet.
        """
        hired: list[_Worker] = []
        while len(hired) < groups and len(crew) < self._workers:
            worker = _Worker(_free_number(crew), WorkerProcess.start())
            crew[worker.pipe] = worker
            hired.append(worker)
        return hired


@dataclass
class _Worker:
    """A process at work, and what it has been given."""

    number: int
    process: WorkerProcess
    unfinished: set[str] = field(default_factory=set)

    @property
    def pipe(self) -> Connection:
        """This end of it."""
        return self.process.pipe

    def hire(self, order: Order, cores: Cores) -> None:
        """Say what all its work is about, and where to do it."""
        self._send((order, self.number, cores))

    def give(self, queue: deque[Group]) -> None:
        """Hand over the next group, or None where none is left."""
        group = queue.popleft() if queue else None
        self.unfinished = {job.sequence_id for job in group or ()}
        self._send(group)

    def _send(self, message: object) -> None:
        # A worker that died meanwhile is noticed when its pipe is read.
        with suppress(BrokenPipeError):
            self.pipe.send(message)


def _free_number(crew: dict[Connection, _Worker]) -> int:
    taken = {worker.number for worker in crew.values()}
    return next(number for number in range(len(taken) + 1) if number not in taken)


def _hear(
    crew: dict[Connection, _Worker], queue: deque[Group], worker: _Worker
) -> Iterator[Outcome]:
    """Take one message from a worker: an outcome, None for "give me more", or a fatal error."""
    try:
        message = worker.pipe.recv()
    except (EOFError, OSError):
        del crew[worker.pipe]
        yield from _lost(worker)
        return
    if isinstance(message, HbbatchError):
        raise message
    if message is None:
        worker.give(queue)
    else:
        worker.unfinished.discard(message.sequence_id)
        yield message


def _lost(worker: _Worker) -> Iterator[Outcome]:
    reason = worker.process.epitaph()
    worker.pipe.close()
    for sequence_id in sorted(worker.unfinished):
        yield Outcome(sequence_id, error=f"its worker process {reason}.")
