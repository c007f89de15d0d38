"""Worker processes as their parent sees them: started, told by a pipe what to do, and stopped.

Nothing heavy is imported here: what workers need can be loaded while their parent still loads what
it needs itself.
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
from functools import cache
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext, SpawnContext
from multiprocessing.process import BaseProcess
from typing import Final, TypeVar

from hbbatch.errors import ExitStatus, HbbatchError

_INTERRUPTED: Final = 128 + signal.SIGINT
_Task = TypeVar("_Task")
_Result = TypeVar("_Result")
_NEEDED: Final = ["hbbatch.runner.worker", "hbbatch.tracking.engine"]
"""Modules of a worker."""

_SPAWN: Final = multiprocessing.get_context("spawn")
_UNKNOWN: Final = 255
"""Exit status of a worker whose server was killed before it."""

_BEGINNING: Final = threading.Lock()
"""Held while the environment is that of workers."""

_PATIENCE_S: Final = 5.0
"""How long a worker may take to stop when asked to."""


@dataclass(frozen=True)
class WorkerProcess:
    """A process that runs `hbbatch.runner.worker.work` on its end of a pipe."""

    process: BaseProcess
    pipe: Connection

    @classmethod
    def start(cls) -> WorkerProcess:
        """A new one.

        Raises:
            HbbatchError: the system lets no process start.
        """
        try:
            return cls._start(_context())
        except (EOFError, OSError):
            pass  # the server was killed, or cannot fork
        try:
            return cls._start(_SPAWN)
        except OSError as error:
            raise HbbatchError(
                f"a worker process cannot start ({error.strerror}). --workers 1 does without."
            ) from error

    @classmethod
    def _start(cls, context: ForkServerContext | SpawnContext) -> WorkerProcess:
        ours, theirs = context.Pipe()
        # Only the child may hold its end, so that its death reads as the end of the pipe.
        with theirs, _as_workers_begin():
            process = context.Process(target=_body, args=(theirs,), daemon=True)
            process.start()
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
        if status == _UNKNOWN:
            return "is gone, as is what would know why (out of memory?). Try fewer --workers"
        if status is not None and status < 0:
            return f"was ended by {signal.Signals(-status).name}"
        return f"ended with status {status}"


def load_ahead(workers: int | None) -> None:
    """Have what workers need loaded while this process does something else.

    Args:
        workers: how many were asked for; None for one a core. One alone does without processes.
    """
    if (workers or available_cores()) > 1:
        _context()


@cache
def _context() -> ForkServerContext | SpawnContext:
    """How processes are made: forked by a server that loads what they need once, on Linux.

    Libraries of other systems do not outlive a fork (Accelerate). There, and where the server
    cannot be reached (no folder for its socket), each process loads its modules itself.
    """
    if sys.platform == "linux":
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(_NEEDED)
        with suppress(OSError), _as_workers_begin():
            forkserver.ensure_running()
            return context
    return _SPAWN


def available_cores() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


Cores = frozenset[int]


def cores_for(number: int, workers: int) -> Cores:
    """The cores that a worker is to use; empty where the system does not keep it to any.

    Where workers leave no core free, each keeps to one. Threads of a worker take turns at the
    interpreter. On one core that costs little; where turns may go to any, the threads of two
    workers push each other from core to core, and the same work takes a tenth longer
    (docs/performance.md). Where there are more cores, threads may use them.

    Args:
        number: of the worker, from 0.
        workers: how many there are.
    """
    if not hasattr(os, "sched_getaffinity"):
        return frozenset()
    cores = sorted(os.sched_getaffinity(0))
    return frozenset([cores[number % len(cores)]] if workers >= len(cores) else cores)


def keep_to(cores: Cores) -> None:
    """Keep this process and the threads it will start to some cores, if any are named."""
    if cores:
        os.sched_setaffinity(0, cores)


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
    import hbbatch.tracking.engine  # noqa: F401 - loaded before anyone waits for it
    from hbbatch.runner.worker import work

    # What is loaded stays: to look for garbage there would take time with each group.
    gc.freeze()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    # The parent is gone when its end of the pipe is: nobody is left to work for.
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        work(pipe)
    # The parent waits for the end, and taking down all that is loaded takes longer than to leave.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(ExitStatus.DONE)


@contextmanager
def _as_workers_begin() -> Iterator[None]:
    """Processes started inside have the variables of `_environment`, and do not see Ctrl-C."""
    with _BEGINNING, interrupts_blocked():
        variables = _environment()
        before = {name: os.environ.get(name) for name in variables}
        os.environ.update(variables)
        try:
            yield
        finally:
            for name, value in before.items():
                os.environ.pop(name) if value is None else os.environ.update({name: value})


def _environment() -> dict[str, str]:
    """With which workers begin: a process without threads can be forked without a thought."""
    return {
        # numpy multiplies in one thread; others would wait for work in a busy loop at first.
        "OPENBLAS_NUM_THREADS": "1",
        # An allocator of Arrow's that is not used keeps a thread all the same.
        "JE_ARROW_MALLOC_CONF": "background_thread:false",
        # Modules are those of this process, not what lies in the current folder.
        "PYTHONSAFEPATH": "1",
        "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path)),
    }


@contextmanager
def _signals_held() -> Iterator[None]:
    """What comes in of Ctrl-C, SIGTERM and SIGHUP inside is handled afterwards.

    To block them would not do: another thread takes them then, and the main one handles them.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    handled = [number for number in numbers if callable(signal.getsignal(number))]
    before = {n: signal.signal(n, lambda number, _: came.append(number)) for n in handled}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for late in came:
            signal.raise_signal(late)


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Processes started inside do not see Ctrl-C: it is the parent's to handle.

    That is done when they have been started: half a process has a word to say about it.
    """
    # Started with the first process otherwise, it would unblock what is blocked here.
    resource_tracker.ensure_running()
    with _signals_held():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
