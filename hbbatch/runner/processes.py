"""Worker processes as their parent sees them: started, told by a pipe what to do, and stopped.

Nothing heavy is imported here: a process can be started before its parent has loaded anything, and
both load what they need at the same time.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Final, TypeVar

from hbbatch.errors import ExitStatus

_SPAWN: Final = multiprocessing.get_context("spawn")
_INTERRUPTED: Final = 128 + signal.SIGINT
_Task = TypeVar("_Task")
_Result = TypeVar("_Result")
_PATIENCE_S: Final = 5.0
"""How long a worker may take to stop when asked to."""


@dataclass(frozen=True)
class WorkerProcess:
    """A process that runs `hbbatch.runner.worker.work` on its end of a pipe."""

    process: SpawnProcess
    pipe: Connection

    @classmethod
    def start(cls) -> WorkerProcess:
        """A new one, which loads its modules while this call returns."""
        ours, theirs = _SPAWN.Pipe()
        process = _SPAWN.Process(target=_body, args=(theirs,), daemon=True)
        with interrupts_blocked():
            process.start()
        # Only the child may hold its end, so that its death reads as the end of the pipe.
        theirs.close()
        return cls(process, ours)

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


class Standby:
    """Where worker processes come from: one may be started already, others start when taken."""

    def __init__(self, ahead: WorkerProcess | None = None) -> None:
        self._ahead = ahead

    @property
    def waits(self) -> bool:
        """Whether a process that was started ahead has nothing to do yet."""
        return self._ahead is not None

    def take(self) -> WorkerProcess:
        """A process that is the caller's to stop."""
        ahead, self._ahead = self._ahead, None
        if ahead is not None and ahead.process.is_alive():
            return ahead
        return WorkerProcess.start()

    def close(self) -> None:
        """Stop what nobody took."""
        if self._ahead is not None:
            self._ahead.stop()
            self._ahead = None


@contextmanager
def started_ahead(workers: int | None) -> Iterator[Standby]:
    """One process started before it is known what it will do, unless the work stays in this one.

    No more than one, however many will be wanted: there may be little to do, or nothing.

    Args:
        workers: how many were asked for; None for one a core.
    """
    wanted = workers or available_cores()
    standby = Standby(WorkerProcess.start() if wanted > 1 else None)
    try:
        yield standby
    finally:
        standby.close()


def available_cores() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def keep_to_a_core(number: int, workers: int) -> None:
    """Where workers leave no core free, keep this one and the threads it will start to one core.

    Threads of a worker take turns at the interpreter. On one core that costs little; where turns
    may go to any, the threads of two workers push each other from core to core, and the same work
    takes a tenth longer (docs/performance.md). Where there are more cores, threads may use them.

    Args:
        number: of this worker, from 0.
        workers: how many there are.
    """
    if not hasattr(os, "sched_setaffinity"):
        return
    cores = sorted(os.sched_getaffinity(0))
    if workers >= len(cores):
        os.sched_setaffinity(0, {cores[number % len(cores)]})


def begin_in_pool() -> None:
    """For processes of a pool, started with `interrupts_blocked`: they end with their parent.

    Ctrl-C ends them without a word, or the task they are at.
    """
    signal.signal(signal.SIGINT, lambda *_: sys.exit(_INTERRUPTED))
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    except SystemExit:  # it was sent while the process was loading
        os._exit(_INTERRUPTED)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent.sentinel,), daemon=True).start()


def in_pool(work: Callable[[_Task], _Result], task: _Task) -> _Result:
    """A task of a pool, where Ctrl-C ends the process and not the task alone: others may follow."""
    try:
        return work(task)
    except SystemExit:
        os._exit(_INTERRUPTED)


def _end_after(sentinel: int) -> None:
    wait([sentinel])
    os._exit(ExitStatus.FAILED)


def _body(pipe: Connection) -> None:
    """What the process does. Until it has loaded all it needs, SIGTERM ends it at once."""
    # numpy multiplies in one thread here; the others would wait for work in a busy loop at first.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    work = _loaded_work()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    # The parent is gone when its end of the pipe is: nobody is left to work for.
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        work(pipe)
    # The parent waits for the end, and taking down all that is loaded takes longer than to leave.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(ExitStatus.DONE)


def _loaded_work() -> Callable[[Connection], None]:
    """`hbbatch.runner.worker.work` with all it needs loaded, before anyone waits for it."""
    gc.disable()
    import hbbatch.tracking.engine  # noqa: F401 - loaded later otherwise
    from hbbatch.runner.worker import work

    # Modules stay: to look for garbage among them is a loss of time, now and for each group.
    gc.freeze()
    gc.enable()
    return work


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Processes started inside do not see Ctrl-C: it is the parent's to handle."""
    # Started with the first process otherwise, it would unblock what is blocked here.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
