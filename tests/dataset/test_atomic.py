"""Whatever happens while a file is written, the old one or the new one is there."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hbbatch.dataset import write_aside
from hbbatch.dataset.atomic import replaced_together
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


def written_together(folder: Path, text: str) -> None:
    """Files `first` and `second` say `text`, `third` is gone."""
    first, second = folder / "first", folder / "second"
    with replaced_together([first, second], gone=[folder / "third"]) as asides:
        for aside in asides:
            aside.write_text(text)


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_files_are_replaced_together(tmp_path: Path) -> None:
    for name in ("first", "second", "third"):
        (tmp_path / name).write_text("old")
    written_together(tmp_path, "new")
    assert contents(tmp_path) == {"first": "new", "second": "new"}


@pytest.mark.parametrize("renames", [0, 1, 2])
def test_the_first_file_is_only_there_beside_others_of_its_time(
    renames: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whenever the process dies, here after so many renames."""
    written_together(tmp_path, "old")
    replace, left = Path.replace, renames

    def dying(path: Path, target: Path) -> Path:
        nonlocal left
        if not left:
            raise KeyboardInterrupt
        left -= 1
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", dying)
    if renames < 2:
        with pytest.raises(KeyboardInterrupt):
            written_together(tmp_path, "new")
        assert "first" not in contents(tmp_path)
    else:
        written_together(tmp_path, "new")
        assert contents(tmp_path) == {"first": "new", "second": "new"}


def test_a_file_that_cannot_be_written_leaves_all_of_them(tmp_path: Path) -> None:
    written_together(tmp_path, "old")
    (tmp_path / "file").touch()
    paths = [tmp_path / "first", tmp_path / "file" / "second"]
    with (
        pytest.raises(DatasetError, match=r"file/second: cannot be written"),
        replaced_together(paths, gone=[tmp_path / "second"]),
    ):
        pass
    assert contents(tmp_path) == {"first": "old", "second": "old", "file": ""}
