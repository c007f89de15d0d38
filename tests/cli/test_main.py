"""What every command has in common: help, version, and errors in one line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hbbatch import __version__
from hbbatch.cli import main as main_module
from hbbatch.cli.main import main
from hbbatch.cli.options import Device, FilterChoice
from hbbatch.config import DeviceName, FilterName
from hbbatch.errors import DatasetError


def hbbatch(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hbbatch", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def run_main(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    """Exit status of the command line in this process."""
    monkeypatch.setattr(sys, "argv", ["hbbatch", *arguments])
    with pytest.raises(SystemExit) as caught:
        main()
    status = caught.value.code
    assert isinstance(status, int)
    return status


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("NUMPY_MADVISE_HUGEPAGE", "0"),
        ("OPENBLAS_NUM_THREADS", "1"),
        ("PYDANTIC_DISABLE_PLUGINS", "__all__"),
    ],
)
def test_libraries_are_told_what_suits_batches_unless_the_user_says_otherwise(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str
) -> None:
    monkeypatch.setenv(name, "7")
    main_module.prepare_libraries()
    assert os.environ[name] == "7"
    monkeypatch.delenv(name)
    main_module.prepare_libraries()
    assert os.environ[name] == value


INTERRUPTED_WHILE_LOADING = """
import os, signal, sys
from hbbatch import __main__

class Interrupts:
    def find_spec(self, name, path, target=None):
        if name == "hbbatch.cli.main":
            os.kill(os.getpid(), signal.SIGINT)

signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupts())
__main__.main()
"""


def test_ctrl_c_while_the_command_loads_ends_it_without_a_word() -> None:
    command = [sys.executable, "-c", INTERRUPTED_WHILE_LOADING]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (-signal.SIGINT, "", "")


@pytest.fixture
def _signals() -> Iterator[None]:
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("_signals")
def test_ctrl_c_before_typer_is_at_it_is_130_without_a_word(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    raise_from_app(monkeypatch, KeyboardInterrupt())
    assert run_main(monkeypatch) == 130
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("_signals")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_what_ends_a_command_is_heeded_unless_it_is_to_be_ignored(
    monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    signal.signal(number, signal.SIG_IGN)  # nohup does so
    main_module.heed_signals()
    signal.raise_signal(number)
    signal.signal(number, signal.SIG_DFL)
    main_module.heed_signals()
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    monkeypatch.setattr("multiprocessing.active_children", lambda: [gone])
    with pytest.raises(SystemExit) as ended:
        signal.raise_signal(number)
    assert ended.value.code == 128 + number


def test_the_version_is_printed() -> None:
    result = hbbatch("--version")
    assert (result.returncode, result.stdout) == (0, f"hbbatch {__version__}\n")


def test_help_names_the_commands(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_main(monkeypatch, "--help") == 0
    shown = capsys.readouterr().out
    for command in ("ingest", "track", "eval", "relabel"):
        assert command in shown


@pytest.mark.parametrize(
    "arguments",
    [["nonsense"], ["track", "--device", "abacus"], ["track", "--workers", "0"], ["relabel"]],
)
def test_usage_errors_exit_2_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    assert run_main(monkeypatch, *arguments) == 2
    assert "Traceback" not in capsys.readouterr().err


def raise_from_app(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def app() -> None:
        raise error

    monkeypatch.setattr(main_module, "app", app)


def test_errors_raised_on_purpose_are_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    raise_from_app(monkeypatch, DatasetError("data: gone.\nLook for it."))
    assert run_main(monkeypatch) == 1
    assert capsys.readouterr().err == "error: data: gone. Look for it.\n"


def test_defects_are_one_line_and_a_hint(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("HBBATCH_TRACEBACK", raising=False)
    raise_from_app(monkeypatch, KeyError("x"))
    assert run_main(monkeypatch) == 1
    shown = capsys.readouterr().err
    assert shown.count("\n") == 1
    assert "KeyError" in shown
    assert "--traceback" in shown


def test_defects_show_where_when_asked(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HBBATCH_TRACEBACK", "1")
    raise_from_app(monkeypatch, KeyError("x"))
    assert run_main(monkeypatch) == 1
    assert capsys.readouterr().err.startswith("Traceback (most recent call last)")


def test_a_reader_that_leaves_is_no_error_message(tmp_path: Path) -> None:
    command = f"{sys.executable} -m hbbatch --help | true"
    result = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, check=False, env=os.environ
    )
    assert result.stderr == ""


def test_completion_is_offered_for_bash() -> None:
    environment = {**os.environ, "_HBBATCH_COMPLETE": "complete_bash", "COMP_WORDS": "hbbatch tr"}
    environment["COMP_CWORD"] = "1"
    command = [sys.executable, "-c", "from hbbatch.cli.main import app; app(prog_name='hbbatch')"]
    result = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert "track" in result.stdout.split()


def test_choices_are_those_of_the_settings() -> None:
    assert {choice.value for choice in Device} == set(DeviceName.__args__)  # type: ignore[attr-defined]
    assert {choice.value for choice in FilterChoice} == set(FilterName.__args__)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "command", [("bench", "no_dataset", "--markdown"), ("study", "no_study.yaml", "--out")]
)
def test_a_page_that_tables_do_not_fit_in_is_refused_before_anything_is_measured(
    command: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = tmp_path / "page.md"
    page.write_text("No markers.\n")
    assert run_main(monkeypatch, *command, str(page)) != 0
    assert f"error: {page}: " in capsys.readouterr().err
