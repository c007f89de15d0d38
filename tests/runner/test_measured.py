"""Commands measured from outside."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from hbbatch.runner.measured import Command, measured

BUSY = """
import time
end = time.process_time() + 0.2
while time.process_time() < end:
    pass
"""

LEAVES_A_BUSY_ONE = f"""
import subprocess, sys
code = "import os; os.close(1); os.close(2)\\n" + {BUSY!r}
print(subprocess.Popen([sys.executable, "-c", code]).pid)
"""


def python(code: str, cores: set[int] | None = None) -> Command:
    return Command([sys.executable, "-c", code], cores)


def test_commands_are_run_and_heard() -> None:
    code = "import sys; print('out'); print('err', file=sys.stderr); sys.exit(3)"
    done = measured([python(code)])
    [ended] = done.ended
    assert (ended.returncode, ended.stdout, ended.stderr) == (3, "out\n", "err\n")


WAITS_FOR_THE_OTHER = """
import sys, time
from pathlib import Path
mine, other = map(Path, ["MINE", "OTHER"])
mine.touch()
while not other.exists():
    time.sleep(0.01)
"""


def test_commands_run_at_once(tmp_path: Path) -> None:
    names = [str(tmp_path / "a"), str(tmp_path / "b")]
    codes = [
        WAITS_FOR_THE_OTHER.replace("MINE", mine).replace("OTHER", other)
        for mine, other in (names, names[::-1])
    ]
    done = measured([python(code) for code in codes])
    assert [ended.returncode for ended in done.ended] == [0, 0]


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="the system cannot pin")
def test_a_command_is_kept_to_its_cores_and_others_are_not() -> None:
    before = os.sched_getaffinity(0)
    code = "import os; print(os.sched_getaffinity(0))"
    done = measured([python(code, {min(before)}), python(code)])
    assert [ended.stdout.strip() for ended in done.ended] == [str({min(before)}), str(before)]
    assert os.sched_getaffinity(0) == before


def test_processor_time_is_counted() -> None:
    done = measured([python(BUSY)])
    assert done.cpu_s >= 0.2


@pytest.mark.skipif(sys.platform != "linux", reason="orphans go to the first process elsewhere")
def test_processor_time_of_what_outlives_the_command_is_counted() -> None:
    done = measured([python(LEAVES_A_BUSY_ONE)])
    assert done.ended[0].stdout.strip().isdigit()
    assert done.cpu_s >= 0.2
