"""Whatever happens while a file is written, the old one or the new one is there."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hbbatch.dataset import write_aside
from hbbatch.errors import DatasetError

KILLED = """
import os, signal, sys
from pathlib import Path
from hbbatch.dataset import write_aside
with write_aside(Path(sys.argv[1])) as aside:
    aside.write_text("half of the new")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_killed_in_the_middle_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("old")
    killed = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert path.read_text() == "old"


def test_an_error_in_the_middle_leaves_the_old_file_alone(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError), write_aside(path) as aside:
        aside.write_text(f"half of the new, {1 / 0}")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_a_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    target = tmp_path / "file" / "inside"
    with pytest.raises(DatasetError, match=r"inside: cannot be written"), write_aside(target):
        pass


def test_a_place_that_is_a_folder_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in (Path(), Path("..")):
        message = pytest.raises(DatasetError, match=r"^\.+: cannot be written")
        with message, write_aside(folder) as aside:
            aside.write_text("new")
    assert not list(tmp_path.iterdir())
