"""A command measured from outside."""

from __future__ import annotations

import sys

import pytest

from hbbatch.runner.measured import measured

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


def test_a_command_is_run_and_heard() -> None:
    code = "import sys; print('out'); print('err', file=sys.stderr); sys.exit(3)"
    done = measured([sys.executable, "-c", code])
    assert (done.status, done.stdout, done.stderr) == (3, "out\n", "err\n")


def test_processor_time_is_counted() -> None:
    done = measured([sys.executable, "-c", BUSY])
    assert done.cpu_s >= 0.2
    assert done.wall_s >= 0.2


@pytest.mark.skipif(sys.platform != "linux", reason="orphans go to the first process elsewhere")
def test_processor_time_of_what_outlives_the_command_is_counted() -> None:
    done = measured([sys.executable, "-c", LEAVES_A_BUSY_ONE])
    assert done.stdout.strip().isdigit()
    assert done.cpu_s >= 0.2
