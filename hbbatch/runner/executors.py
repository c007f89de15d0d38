"""Where groups of sequences are tracked: in this process, or in worker processes beside it."""

from __future__ import annotations

import multiprocessing
import signal
import sys
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Final, Protocol

from hbbatch.errors import HbbatchError
from hbbatch.runner.dealing import Group
from hbbatch.runner.worker import LoadedTracker, Order, Outcome, track_group

_SPAWN: Final = multiprocessing.get_context("spawn")
_PATIENCE_S: Final = 5.0
"""How long a worker may take to stop when asked to."""


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
        loaded = order.load_tracker(order.settings, order.device)
        for group in groups:
            yield from track_group(order, loaded, group, worker=0)


class ProcessExecutor:
    """Groups in worker processes, each with its own tracker and its own pipe.

    A worker that dies takes only the unfinished sequences of its group with it: they come out as
    failed, and a fresh worker goes on with the groups that are left.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers

    def run(self, order: Order, groups: Sequence[Group]) -> Generator[Outcome, None, None]:
        """See `Executor.run`."""
        queue = deque(groups)
        crew: dict[Connection, _Worker] = {}
        try:
            while queue or crew:
                while queue and len(crew) < self._workers:
                    worker = _Worker.start(order, _free_number(crew))
                    crew[worker.pipe] = worker
                    worker.give(queue)
                for pipe in wait(list(crew)):
                    yield from _hear(crew, queue, crew[pipe])  # type: ignore[index]
        finally:
            for worker in crew.values():
                worker.stop()


@dataclass
class _Worker:
    """A worker process as its parent sees it."""

    number: int
    process: SpawnProcess
    pipe: Connection
    unfinished: set[str] = field(default_factory=set)

    @classmethod
    def start(cls, order: Order, number: int) -> _Worker:
        ours, theirs = _SPAWN.Pipe()
        process = _SPAWN.Process(target=_work, args=(theirs, order, number), daemon=True)
        with _interrupts_blocked():
            process.start()
        # Only the child may hold its end, so that its death reads as the end of the pipe.
        theirs.close()
        return cls(number, process, ours)

    def give(self, queue: deque[Group]) -> None:
        """Hand over the next group, or None where none is left."""
        group = queue.popleft() if queue else None
        self.unfinished = {job.sequence_id for job in group or ()}
        # A worker that died meanwhile is noticed when its pipe is read.
        with suppress(BrokenPipeError):
            self.pipe.send(group)

    def stop(self) -> None:
        """Ask the process to end, then end it."""
        self.pipe.close()
        self.process.terminate()
        self.process.join(_PATIENCE_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()

    def epitaph(self) -> str:
        """Why a process that is gone is gone."""
        self.process.join(_PATIENCE_S)
        status = self.process.exitcode
        if status == -signal.SIGKILL:
            return "was killed (out of memory?). Try fewer --workers"
        if status is not None and status < 0:
            return f"was ended by {signal.Signals(-status).name}"
        return f"ended with status {status}"


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
    reason = worker.epitaph()
    worker.pipe.close()
    for sequence_id in sorted(worker.unfinished):
        yield Outcome(sequence_id, error=f"its worker process {reason}.")


def _work(pipe: Connection, order: Order, number: int) -> None:
    """Body of a worker process: groups come in by the pipe, outcomes go out."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    # The parent is gone when its end of the pipe is: nobody is left to work for.
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        loaded = _load(pipe, order)
        while loaded and (group := pipe.recv()) is not None:
            for outcome in track_group(order, loaded, group, number):
                pipe.send(outcome)
            pipe.send(None)


def _load(pipe: Connection, order: Order) -> LoadedTracker | None:
    try:
        return order.load_tracker(order.settings, order.device)
    except HbbatchError as error:
        pipe.send(error)
    except Exception as error:  # noqa: BLE001 - the parent has to hear of it, whatever it is
        pipe.send(HbbatchError(f"a worker cannot start ({type(error).__name__}: {error})."))
    return None


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Processes started inside never see Ctrl-C: it is the parent's to handle."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
