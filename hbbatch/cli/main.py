"""The `hbbatch` command: collects the commands and turns errors into one line and a status.

Nothing heavy is imported here or at the top of a command's module, so `--help` answers at once.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import sys
from contextlib import suppress
from types import FrameType
from typing import Annotated, Final, NoReturn

import typer

from hbbatch import __version__
from hbbatch.cli.bench import bench
from hbbatch.cli.calibrate import calibrate
from hbbatch.cli.demo import demo
from hbbatch.cli.detector_errors import detector_errors
from hbbatch.cli.eval import evaluate
from hbbatch.cli.info import info
from hbbatch.cli.ingest import ingest
from hbbatch.cli.relabel import relabel
from hbbatch.cli.simulate import simulate
from hbbatch.cli.study import study
from hbbatch.cli.track import track
from hbbatch.cli.train import train
from hbbatch.cli.weights import app as weights_app
from hbbatch.errors import TRACEBACK_VARIABLE, ExitStatus, HbbatchError, report_defect

app = typer.Typer(
    name="hbbatch",
    help="Turn logged drives with 3D detections into object tracks, offline and in batches.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
app.command()(ingest)
app.command()(info)
app.command()(track)
app.command("eval")(evaluate)
app.command()(calibrate)
app.command()(relabel)
app.command()(demo)
app.command()(simulate)
app.command()(detector_errors)
app.command()(train)
app.command()(bench)
app.command()(study)
app.add_typer(weights_app, name="weights")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"hbbatch {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
    traceback: Annotated[
        bool,
        typer.Option(
            "--traceback",
            envvar=TRACEBACK_VARIABLE,
            help="Show where an unexpected error came from.",
        ),
    ] = False,
) -> None:
    if traceback:
        os.environ[TRACEBACK_VARIABLE] = "1"


_ENVIRONMENT: Final = {
    # numpy's arrays live for a block of a log or a part of the sequences, and for each the system
    # would clear pages of 2 MB as a whole: in a virtual machine that was up to half of an ingest's
    # time (docs/performance_ingest.md).
    "NUMPY_MADVISE_HUGEPAGE": "0",
    # It multiplies small matrices only. Other threads would wait for work in a busy loop at first,
    # on the core that a worker loads its modules on.
    "OPENBLAS_NUM_THREADS": "1",
    # Looking for plugins reads the metadata of all that is installed.
    "PYDANTIC_DISABLE_PLUGINS": "__all__",
}


def prepare_libraries() -> None:
    """Tell numpy and pydantic, before they load, what suits batches: here and in processes to come.

    What the environment says already stays.
    """
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)


def _end(signal_number: int, _frame: FrameType | None) -> NoReturn:
    """What a scheduler asks for ends as Ctrl-C does, which a terminal tells all processes of."""
    for child in multiprocessing.active_children():
        if child.pid is not None:
            with suppress(ProcessLookupError):
                os.kill(child.pid, signal.SIGINT)
    sys.exit(128 + signal_number)


def heed_signals() -> None:
    """Ctrl-C, SIGTERM and SIGHUP end the command in order, but those that it was told to ignore."""
    handlers = {
        signal.SIGINT: signal.default_int_handler,
        signal.SIGTERM: _end,
        signal.SIGHUP: _end,
    }
    for number, handler in handlers.items():
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, handler)


def main() -> None:
    """Run the command line: an error is one line on stderr and an exit status.

    Usage errors (2), Ctrl-C (130) and a reader that leaves are typer's to handle.
    """
    try:
        prepare_libraries()
        heed_signals()
        app()
    except KeyboardInterrupt:  # before typer is at it
        sys.exit(128 + signal.SIGINT)
    except HbbatchError as error:
        _fail(str(error), error.exit_status)
    except Exception as error:  # noqa: BLE001 - the user is told of a defect in one line
        _fail(report_defect(error), ExitStatus.FAILED)
    finally:
        # Python looks for garbage among all objects at its end, for a tenth of a second.
        gc.freeze()


def _fail(message: str, status: int) -> None:
    typer.echo(f"error: {' '.join(message.split())}", err=True)
    sys.exit(status)
