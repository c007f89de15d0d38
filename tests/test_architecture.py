"""Rules that hold for the whole repository."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from hbbatch import __version__
from hbbatch.config import TrackSettings, validate
from hbbatch.runner.jobfile import RelabelJob
from hbbatch.runner.track import TrackRequest, track
from tests.runner.small_dataset import ECHO, make_dataset

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
HEAVY = ("torch", "pyarrow", "scipy", "pydantic", "numpy", "trackeval")


def python(code: str, cwd: Path = ROOT) -> str:
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=True, cwd=cwd).stdout


def test_imports_keep_to_the_direction_of_the_flow() -> None:
    code = (
        "from importlinter.cli import lint_imports; raise SystemExit(lint_imports(no_cache=True))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert result.returncode == 0, result.stdout + result.stderr


def loaded_after(code: str) -> set[str]:
    names = "print(*{name.partition('.')[0] for name in sys.modules})"
    return set(HEAVY) & set(python(f"import sys\n{code}\n{names}").split())


def test_the_command_line_imports_nothing_heavy() -> None:
    """What makes `hbbatch --help` answer at once, without a clock that depends on the machine."""
    assert loaded_after("from hbbatch.cli.main import app") == set()


@pytest.mark.parametrize("command", [[], ["ingest"], ["track"], ["eval"], ["relabel"], ["demo"]])
def test_help_imports_nothing_heavy(command: list[str]) -> None:
    code = (
        "import contextlib, io\n"
        "from hbbatch.cli.main import app\n"
        "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):\n"
        f"    app({[*command, '--help']})"
    )
    # Newer versions of typer import pydantic themselves.
    assert loaded_after(code) <= {"pydantic"}


def test_what_workers_need_is_loaded_while_the_command_loads_its_own() -> None:
    assert loaded_after("from hbbatch.runner.processes import load_ahead") == set()
    code = (
        "from hbbatch.cli.track import track\n"
        "from hbbatch.runner import processes\n"
        "def load_ahead(workers):\n"
        "    raise SystemExit(0 if workers == 3 else 1)\n"
        "processes.load_ahead = load_ahead\n"
        "try:\n"
        "    track(workers=3)\n"
        "except SystemExit as end:\n"
        "    assert end.code == 0"
    )
    assert loaded_after(code) <= {"pydantic"}


def test_planning_a_run_needs_nothing_of_what_workers_do() -> None:
    """So that a command that finds nothing to do answers soon."""
    code = (
        "import sys, hbbatch.runner.track, hbbatch.runner.track_settings\n"
        "print({'torch', 'yaml', 'pyarrow.compute', 'hbbatch.runner.worker'} & sys.modules.keys())"
    )
    assert python(code).strip() == "set()"


@pytest.mark.parametrize("device", ["auto", "cpu"])
@pytest.mark.usefixtures("kernels")
def test_tracking_on_a_cpu_needs_no_torch(tmp_path: Path, device: str) -> None:
    """Loading it takes longer than tracking fifty sequences."""
    make_dataset(tmp_path, "a")
    code = (
        "import sys\n"
        "from pathlib import Path\n"
        "from hbbatch.config import TrackSettings\n"
        "from hbbatch.runner import device\n"
        "from hbbatch.runner.track import TrackRequest, track\n"
        "device.driver_found = lambda: False\n"
        f"request = TrackRequest(Path({str(tmp_path)!r}), TrackSettings(), device={device!r},"
        " workers=1)\n"
        "report = track(request)\n"
        "print('torch' in sys.modules, report.failed, len(report.tracked))"
    )
    assert python(code).strip() == "False {} 1"


def readme_commands() -> list[str]:
    return re.findall(r"^    (.+)$", README, re.MULTILINE)


def test_the_readme_starts_with_install_and_tests() -> None:
    install, tests = readme_commands()[:2]
    assert install.startswith("python3 -m venv")
    assert install.endswith("hbbatch demo")
    assert tests == ".venv/bin/python -m pytest"


def test_the_readme_install_brings_what_the_tests_need() -> None:
    assert "'.[dev]'" in readme_commands()[0]
    pyproject = (ROOT / "pyproject.toml").read_text()
    assert '"hbbatch[eval]"' in pyproject.partition("dev = [")[2]


def test_the_image_is_installed_as_the_readme_says() -> None:
    dockerfile = (ROOT / "Dockerfile").read_text()
    (extras,) = re.findall(r"pip install .*?(\[\w+\])", dockerfile)
    assert f"pip install '.{extras}'" in readme_commands()
    assert re.search(r"^USER (?!root)\w+$", dockerfile, re.MULTILINE)
    assert 'ENTRYPOINT ["hbbatch"]' in dockerfile
    for copied in re.findall(r"^COPY (?!--from)(.+) \S+$", dockerfile, re.MULTILINE):
        assert all((ROOT / name).exists() for name in copied.split())


def test_commands_of_the_readme_exist() -> None:
    known = python(
        "from hbbatch.cli.main import app; print(*(c.name or c.callback.__name__"
        " for c in app.registered_commands))"
    ).split()
    used = set(re.findall(r"hbbatch ([a-z]+)", "\n".join(readme_commands())))
    assert used <= set(known)


def test_links_of_the_readme_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target


def test_the_table_snippet_of_the_readme_runs(tmp_path: Path) -> None:
    make_dataset(tmp_path / "hbbatch_data", "a")
    request = TrackRequest(tmp_path / "hbbatch_data", TrackSettings(), run="RUN", workers=1)
    track(request, engine=ECHO)
    snippet = re.findall(r"```python\n(.*?)```", README, re.DOTALL)[0]
    assert "m/s" in python(snippet, tmp_path)


@pytest.mark.parametrize("path", sorted((ROOT / "pipelines").glob("*.yaml")), ids=lambda p: p.name)
def test_job_files_hold_known_keys_only(path: Path) -> None:
    validate(RelabelJob, yaml.safe_load(path.read_text()), str(path))


def test_the_version_is_one() -> None:
    assert f'version = "{__version__}"' in (ROOT / "pyproject.toml").read_text()


def own_files() -> Iterator[Path]:
    for folder in ("hbbatch", "tests", "docs", "pipelines", ".ci"):
        yield from (p for p in (ROOT / folder).rglob("*") if p.is_file())
    yield from (p for p in ROOT.iterdir() if p.suffix in {".md", ".toml"} or p.name == "Dockerfile")


def test_no_file_names_a_folder_of_somebodys_machine() -> None:
    homes = "|".join(("home", "root", "Users", "work", "tmp"))
    personal = re.compile(rf"(?<![\w.}}*~-])/(?:{homes})/\w")
    texts = (p for p in own_files() if p.suffix not in {".pyc", ".safetensors"})
    assert [str(p) for p in texts if personal.search(p.read_text(errors="ignore"))] == []
