"""Worker processes: loaded ahead, told to stop, and left alone by Ctrl-C."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from hbbatch.config import TrackSettings
from hbbatch.errors import HbbatchError
from hbbatch.runner.processes import (
    WorkerProcess,
    _as_workers_begin,
    cores_for,
    interrupts_blocked,
)
from hbbatch.runner.track import TrackRequest, track
from tests.runner.small_dataset import ECHO, make_dataset


@pytest.fixture
def worker() -> Iterator[WorkerProcess]:
    process = WorkerProcess.start()
    yield process
    process.stop()


def test_a_process_that_is_told_to_stop_is_gone(worker: WorkerProcess) -> None:
    worker.stop()
    assert not worker.process.is_alive()


LOADED_AHEAD = """
import sys, time
from hbbatch.runner.processes import WorkerProcess, load_ahead

class Said:
    def __reduce__(self):
        return said, ()

def said():
    loaded = "hbbatch.tracking.engine" in sys.modules
    raise SystemExit(7 if loaded else 8)

if __name__ == "__main__":
    load_ahead(workers=2)
    process = WorkerProcess.start()
    process.process.join(0)
    process.pipe.send(Said())
    process.process.join()
    here = "hbbatch.tracking.engine" in sys.modules
    print(process.process.exitcode, here, type(process.process).__name__)
"""


def test_a_worker_has_loaded_what_it_needs_before_it_is_told_anything(tmp_path: Path) -> None:
    """And its parent has not."""
    assert run_fresh(tmp_path, LOADED_AHEAD).startswith("7 False ")


PRELOADED = """
import sys
from hbbatch.runner import processes

def report():
    sys.exit(7 if "hbbatch.tracking.engine" in sys.modules else 8)

if __name__ == "__main__":
    plain = processes._context().Process(target=report)
    plain.start()
    plain.join()
    print(plain.exitcode)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux only")
def test_what_forks_workers_has_loaded_what_they_need(tmp_path: Path) -> None:
    assert run_fresh(tmp_path, PRELOADED) == "7"


def test_modules_are_not_those_of_the_current_folder(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "numpy.py").write_text("raise RuntimeError")
    assert run_fresh(tmp_path, LOADED_AHEAD, cwd=elsewhere).startswith("7 False ")


KILLED_WHILE_FORKING = """
import os, signal, threading, time
from pathlib import Path
from hbbatch.runner.processes import WorkerProcess, load_ahead

def server():
    [task] = Path("/proc/self/task").iterdir()
    while True:
        for child in (task / "children").read_text().split():
            if b"forkserver" in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)

if __name__ == "__main__":
    load_ahead(workers=2)
    pid = server()
    os.kill(pid, signal.SIGSTOP)
    threading.Timer(0.3, os.kill, [pid, signal.SIGKILL]).start()
    process = WorkerProcess.start()
    process.pipe.close()
    process.process.join()
    print(process.process.exitcode)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux only")
def test_workers_start_though_what_forks_them_is_killed_at_it(tmp_path: Path) -> None:
    assert run_fresh(tmp_path, KILLED_WHILE_FORKING) == "0"


def test_where_no_process_can_start_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def start(_process: object) -> None:
        raise BlockingIOError(errno.EAGAIN, "no more processes")

    monkeypatch.setattr("multiprocessing.process.BaseProcess.start", start)
    with pytest.raises(HbbatchError, match=r"cannot start \(no more processes\)"):
        WorkerProcess.start()


@pytest.fixture
def _heeds_ctrl_c() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_heeds_ctrl_c")
def test_ctrl_c_waits_until_a_process_has_been_started() -> None:
    """Half of one would have its own word to say."""
    done = []
    go = threading.Event()

    def interrupt() -> None:
        go.wait()
        signal.raise_signal(signal.SIGINT)

    # One that takes the signal, for it was there before this one blocked it.
    other = threading.Thread(target=interrupt)
    other.start()

    def begin() -> None:
        with interrupts_blocked():
            go.set()
            other.join()
            done.append("started")

    with pytest.raises(KeyboardInterrupt):
        begin()
    assert done == ["started"]


def test_the_environment_stays_whoever_starts_workers_at_once() -> None:
    before = dict(os.environ)

    def begin(_: int) -> None:
        with _as_workers_begin():
            assert os.environ["OPENBLAS_NUM_THREADS"] == "1"

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(begin, range(400)))
    assert dict(os.environ) == before


FORKED = """
import os
from pathlib import Path
from hbbatch.runner.processes import WorkerProcess, load_ahead

if __name__ == "__main__":
    load_ahead(workers=2)
    processes = [WorkerProcess.start(), WorkerProcess.start()]
    stat = [Path(f"/proc/{p.process.pid}/stat").read_text().rsplit(")", 1)[1] for p in processes]
    [server] = {int(line.split()[1]) for line in stat}
    print(server == os.getpid(), len(os.listdir(f"/proc/{server}/task")))
    for process in processes:
        process.stop()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux only")
def test_workers_are_forked_by_a_process_of_one_thread(tmp_path: Path) -> None:
    """Whatever holds a lock in another thread would hold it for ever in what is forked."""
    assert run_fresh(tmp_path, FORKED) == "False 1"


def test_where_there_is_no_folder_for_a_socket_workers_start_all_the_same(tmp_path: Path) -> None:
    deep = tmp_path / ("d" * 100)
    deep.mkdir()
    assert run_fresh(tmp_path, LOADED_AHEAD, TMPDIR=str(deep)) == "7 False SpawnProcess"


LEFT_ALONE = """
from multiprocessing import active_children
from hbbatch.runner import processes

processes.available_cores = lambda: CORES
if __name__ == "__main__":
    processes.load_ahead(WORKERS)
    print(processes._context.cache_info().currsize)
"""


@pytest.mark.parametrize(
    ("workers", "cores", "loads"), [(1, 8, "0"), (None, 1, "0"), (2, 1, "1"), (None, 8, "1")]
)
def test_nothing_is_loaded_ahead_for_one_worker(
    tmp_path: Path, workers: int | None, cores: int, loads: str
) -> None:
    code = LEFT_ALONE.replace("CORES", str(cores)).replace("WORKERS", str(workers))
    assert run_fresh(tmp_path, code) == loads


def test_work_that_does_not_divide_is_another_process_s(tmp_path: Path) -> None:
    """In this one, nobody would be left to say what killed it."""
    make_dataset(tmp_path, "a", "kills")
    report = track(TrackRequest(tmp_path, TrackSettings(), workers=2), engine=ECHO)
    assert "was killed" in report.failed["kills"]
    assert report.workers == 1


def test_workers_keep_to_a_core_each_where_they_leave_none_free(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {2, 5, 7}, raising=False)
    assert [cores_for(number, 3) for number in range(4)] == [{2}, {5}, {7}, {2}]
    assert cores_for(1, 2) == {2, 5, 7}
    monkeypatch.delattr(os, "sched_getaffinity")
    assert cores_for(1, 2) == frozenset()


def test_a_process_ends_when_nobody_is_left_to_work_for(worker: WorkerProcess) -> None:
    worker.pipe.close()
    worker.process.join()
    assert worker.process.exitcode == 0


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


def run_fresh(folder: Path, code: str, cwd: Path | None = None, **variables: str) -> str:
    """What a script says in a process of its own, without a word of error."""
    script = folder / "parent.py"
    script.write_text(code)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), **variables}
    command = [sys.executable, str(script)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, env=environment, cwd=cwd
    )
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
