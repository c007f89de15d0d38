"""Worker processes: started ahead, taken, told to stop, and left alone by Ctrl-C."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hbbatch.config import TrackSettings
from hbbatch.runner.processes import Standby, WorkerProcess, started_ahead
from hbbatch.runner.track import TrackRequest, track
from tests.runner.small_dataset import ECHO, make_dataset


@pytest.fixture
def ahead() -> Iterator[WorkerProcess]:
    process = WorkerProcess.start()
    yield process
    process.stop()


def test_a_process_that_was_started_ahead_is_taken_once(ahead: WorkerProcess) -> None:
    standby = Standby(ahead)
    assert standby.waits
    assert standby.take() is ahead
    assert not standby.waits
    other = standby.take()
    other.stop()
    assert other is not ahead
    standby.close()
    assert ahead.process.is_alive()


def test_a_process_that_has_died_meanwhile_is_replaced(ahead: WorkerProcess) -> None:
    ahead.process.kill()
    ahead.process.join()
    other = Standby(ahead).take()
    assert other.process.is_alive()
    other.stop()


def test_what_nobody_took_is_stopped() -> None:
    with started_ahead(workers=2) as standby:
        process = standby._ahead
    assert process is not None
    assert process.process.exitcode is not None


def test_nothing_is_started_ahead_for_one_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    with started_ahead(workers=1) as standby:
        assert not standby.waits
    monkeypatch.setattr("hbbatch.runner.processes.available_cores", lambda: 1)
    with started_ahead(workers=None) as standby:
        assert not standby.waits


def test_work_that_does_not_divide_goes_to_the_process_started_ahead(tmp_path: Path) -> None:
    make_dataset(tmp_path, "a", "kills")
    with started_ahead(workers=2) as standby:
        report = track(TrackRequest(tmp_path, TrackSettings()), engine=ECHO, standby=standby)
        assert not standby.waits
    # In this process, nobody would be left to say so.
    assert "was killed" in report.failed["kills"]
    assert report.workers == 1


def test_a_process_ends_when_nobody_is_left_to_work_for(ahead: WorkerProcess) -> None:
    ahead.pipe.close()
    ahead.process.join()
    assert ahead.process.exitcode == 0


INTERRUPTED = """
import os, signal
from hbbatch.runner.processes import WorkerProcess

if __name__ == "__main__":
    first = WorkerProcess.start()
    os.kill(first.process.pid, signal.SIGINT)
    first.pipe.close()
    first.process.join()
    print(first.process.exitcode)
"""


def run_fresh(folder: Path, code: str) -> str:
    """What a script says in a process of its own, without a word of error."""
    script = folder / "parent.py"
    script.write_text(code)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, str(script)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert done.stderr == ""
    return done.stdout.strip()


def test_the_first_process_of_a_parent_never_sees_an_interrupt(tmp_path: Path) -> None:
    """In a fresh parent: what Python starts beside its first process unblocks the signal."""
    assert run_fresh(tmp_path, INTERRUPTED) == "0"


KILLED = """
import os, signal, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from hbbatch.runner.processes import begin_in_pool

if __name__ == "__main__":
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=begin_in_pool)
    print(pool.submit(os.getpid).result(), flush=True)
    pool.submit(time.sleep, 600)
    os.kill(os.getpid(), signal.SIGKILL)
"""


STOPPED = """
import os, signal, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from hbbatch.runner.processes import begin_in_pool, interrupts_blocked

if __name__ == "__main__":
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=begin_in_pool)
    with interrupts_blocked():
        done = pool.submit(os.getpid)
    if EARLY:
        [pid] = pool._processes
    else:
        pid = done.result()
    os.kill(pid, signal.SIGINT)
    pool.shutdown()
"""


@pytest.mark.parametrize("early", [True, False])
def test_a_pool_is_interrupted_without_a_word(early: bool, tmp_path: Path) -> None:
    """While its process loads, and while it waits for work."""
    assert run_fresh(tmp_path, STOPPED.replace("EARLY", str(early))) == ""


NO_FURTHER = """
import os, signal, sys, time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from hbbatch.runner.processes import begin_in_pool, in_pool, interrupts_blocked

def work(path):
    path.write_text("begun")
    time.sleep(600)

if __name__ == "__main__":
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=begin_in_pool)
    paths = [Path(__file__).parent / name for name in ("first", "second")]
    with interrupts_blocked():
        futures = [pool.submit(in_pool, work, path) for path in paths]
    while not paths[0].exists():
        time.sleep(0.01)
    [pid] = pool._processes
    os.kill(pid, signal.SIGINT)
    try:
        futures[0].result()
    except BrokenProcessPool:
        print([path.name for path in paths if path.exists()])
"""


def test_a_pool_begins_nothing_more_once_it_is_interrupted(tmp_path: Path) -> None:
    assert run_fresh(tmp_path, NO_FURTHER) == "['first']"


def test_a_pool_ends_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    """Its processes hold this pipe: it ends when they do."""
    script = tmp_path / "parent.py"
    script.write_text(KILLED)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
        timeout=120,
    )
    assert done.returncode == -signal.SIGKILL
    assert done.stdout.strip().isdigit(), "one had started"
