"""`hbbatch train`: weights from labelled sequences."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hbbatch.cli.options import (
    DEFAULT_DATASET,
    DatasetsOption,
    FilterChoice,
    JsonOption,
    MotionChoice,
)

if TYPE_CHECKING:
    from hbbatch.runner.train import TrainReport


def train(
    out: Annotated[Path, typer.Argument(help="Weights file to write (.safetensors).")],
    dataset: DatasetsOption = None,
    hold_out: Annotated[
        list[str] | None,
        typer.Option(help="Sequence to judge on instead of training on it. Repeatable."),
    ] = None,
    filter_name: Annotated[
        FilterChoice,
        typer.Option("--filter", help="hybrid: learned; kalman: noise of the classical filter."),
    ] = FilterChoice.HYBRID,
    measurements: Annotated[
        str | None,
        typer.Option(help="What the filter is fed: detections (default) or labels (the paper)."),
    ] = None,
    motion_model: Annotated[
        MotionChoice | None, typer.Option(help="Of the classical filter, also as the base.")
    ] = None,
    iterations: Annotated[int | None, typer.Option(min=1, help="Training iterations.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all randomness.")] = None,
    config: Annotated[
        Path | None, typer.Option(help="YAML file of training settings (docs/accuracy.md).")
    ] = None,
    licence: Annotated[
        str, typer.Option(help="Terms of the weights, kept in the file.")
    ] = "unstated: that of the training data",
    as_json: JsonOption = False,
) -> None:
    """Train a filter on labelled sequences."""
    from hbbatch.config import validate
    from hbbatch.model.train_settings import TrainSettings
    from hbbatch.runner.train import train as run_training
    from hbbatch.yaml_files import load_yaml

    content: dict[str, Any] = load_yaml(config) if config else {}
    given = {
        "measurements": measurements,
        "motion_model": motion_model,
        "iterations": iterations,
        "seed": seed,
    }
    content |= {name: value for name, value in given.items() if value is not None}
    settings = validate(TrainSettings, content, str(config or "train options"))
    report = run_training(
        dataset or [DEFAULT_DATASET],
        out,
        settings,
        kind=filter_name.value,
        hold_out=hold_out or (),
        licence=licence,
        progress=_print_progress if sys.stderr.isatty() else _silent,
    )
    typer.echo(json.dumps(report.to_json(), indent=2)) if as_json else _print(report)


def _silent(_stage: str, _iteration: int, _count: int, _loss: float) -> None:
    pass


def _print_progress(stage: str, iteration: int, count: int, loss: float) -> None:
    if (iteration + 1) % 10 == 0:
        end = "\n" if iteration + 1 == count else ""
        typer.echo(f"\r{stage} {iteration + 1}/{count}  loss {loss:.4f}", nl=False, err=True)
        typer.echo(end, nl=False, err=True)


def _print(report: TrainReport) -> None:
    typer.echo(
        f"{report.path}: {report.parameters:,} parameters, {report.tracklets:,} tracklets of "
        f"{len(report.sequences)} sequences, {report.seconds:.0f} s, "
        f"loss {report.losses[0]:.3f} -> {report.losses[1]:.3f}"
    )
    where = ", ".join(report.held_out) or "the training sequences themselves"
    typer.echo(f"errors on {where} (plan view, metres):")
    for kind, errors in report.errors.items():
        for error in errors:
            what = f"{error.frames_ahead:2d} ahead" if error.frames_ahead else "posterior"
            every = f"  every {error.stride}. frame" if error.stride > 1 else ""
            typer.echo(f"  {kind:10s} age {error.age:2d}  {what:9s}  {error.plan_m:.3f}{every}")
    typer.echo("calibration (mean square over variance; share within 50, 90, 99 %):")
    for kind, lines in report.calibration.items():
        for line in lines:
            within = " ".join(f"{100 * share:3.0f}" for share in line.within)
            typer.echo(
                f"  {kind:10s} {line.checked:10s} {line.axis:6s}  {line.mean_square:5.2f}  {within}"
            )
