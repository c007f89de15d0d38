"""`hbbatch weights`: what ships in the package."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import typer

from hbbatch.cli.options import JsonOption

if TYPE_CHECKING:
    from hbbatch.model.weights_files import WeightsHeader

app = typer.Typer(help="Weights in the package: licence and origin.", no_args_is_help=True)


@app.callback()
def _root() -> None:
    pass


@app.command("list")
def list_weights(as_json: JsonOption = False) -> None:
    """List shipped weights, what they were trained on, and under which terms they may be used."""
    from hbbatch.model.weights_files import read_header, shipped_names, weights_path
    from hbbatch.tracking.confidence import TERMS

    headers = {name: read_header(weights_path(name)) for name in shipped_names()}
    if as_json:
        found = {name: vars(header) for name, header in headers.items()}
        typer.echo(json.dumps(found | {"confidence": {"about": {"licence": TERMS}}}, indent=2))
        return
    for name, header in headers.items():
        typer.echo(f"{name}\n{_describe(header)}")
    typer.echo(
        "confidence (of boxes, with any of these weights, once the scale of scores is known)\n"
        f"  licence     {TERMS}"
    )


def _describe(header: WeightsHeader) -> str:
    about = header.about
    lines = {
        "filter": f"{header.filter}, {about.get('parameters', 0):,} parameters",
        "licence": about.get("licence", "unstated"),
        "trained on": f"{about.get('tracklets', 0):,} tracklets of "
        f"{len(about.get('sequences', []))} sequences",
        "classes": ", ".join(header.kind_of_class),
    }
    return "\n".join(f"  {name:11s} {value}" for name, value in lines.items())
