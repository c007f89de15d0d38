"""The `hbbatch` command: collects the commands and turns errors into one line and a status.

Nothing heavy is imported here or at the top of a command's module, so `--help` answers at once.
"""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from hbbatch import __version__
from hbbatch.cli.eval import evaluate
from hbbatch.cli.ingest import ingest
from hbbatch.errors import HbbatchError

app = typer.Typer(
    name="hbbatch",
    help="Turn logged drives with 3D detections into object tracks, offline and in batches.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
app.command()(ingest)
app.command("eval")(evaluate)


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
) -> None:
    pass


def main() -> None:
    """Run the command line; errors raised on purpose become one line on stderr."""
    try:
        app()
    except HbbatchError as error:
        typer.echo(f"error: {error}", err=True)
        sys.exit(error.exit_status)
