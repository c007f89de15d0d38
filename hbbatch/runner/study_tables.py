"""What a study measured, as Markdown tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial

from hbbatch.model.calibration import Calibration
from hbbatch.model.horizon import FilterError
from hbbatch.runner.study import StudyReport
from hbbatch.runner.study_smoothers import Errors

_Key = tuple[str, str | int, str | int, str | int]
_Measured = tuple[_Key, int, tuple[float, ...]]
"""What was measured, on how many boxes, and the values."""
_Row = tuple[str, Callable[[list[float]], str]]
"""First cells of a row, and what its other cells show of the values."""


def markdown(report: StudyReport) -> str:
    """The report as Markdown tables: scores, filter errors, fitted smoothers, calibration."""
    tables = (
        _score_lines(report),
        _error_lines(report),
        _dense_lines(report),
        _calibration_lines(report),
    )
    return "\n\n".join("\n".join(table) for table in tables) + "\n"


def _score_lines(report: StudyReport) -> list[str]:
    lines = [
        "| detections | protocol | class | variant | seed "
        "| HOTA | DetA | AssA | LocA | MOTA | IDSW |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    rows = sorted(report.rows, key=lambda r: (r.dataset, r.protocol, r.class_name))
    for row in rows:
        s = row.scores
        lines.append(
            f"| {row.dataset} | {row.protocol} | {row.class_name} | {row.variant} | {row.seed} "
            f"| {s.hota:.2f} | {s.deta:.2f} | {s.assa:.2f} | {s.loca:.2f} | {s.mota:.2f} "
            f"| {s.idsw} |"
        )
    return lines


def _error_lines(report: StudyReport) -> list[str]:
    """Plan-view errors, metres; folds weighted by their boxes."""

    def rows(key: _Key) -> Iterator[_Row]:
        kind, stride, age, ahead = key
        yield f"{kind} | {stride} | {age} | {ahead or 'posterior'}", lambda v: f"{v[0]:.3f}"

    pooled = {name: _pooled(_errors(folds)) for name, folds in report.errors.items()}
    return _side_by_side("kind | every k-th frame | age | frames ahead", pooled, rows)


def _dense_lines(report: StudyReport) -> list[str]:
    """Errors of posteriors, detections and smoothed detections, metres."""

    def rows(key: _Key) -> Iterator[_Row]:
        for place, axis in enumerate(("seen from above", "along", "across", "up")):
            yield f"{key[0]} | {axis}", partial(_value, place)

    pooled = {name: _pooled(_dense_errors(folds)) for name, folds in report.dense.items()}
    return _side_by_side("detections | vehicles without a gap, error", pooled, rows)


def _calibration_lines(report: StudyReport) -> list[str]:
    """Mean square of errors over their variance, and shares within the 50, 90, 99 % intervals."""

    def rows(key: _Key) -> Iterator[_Row]:
        kind, checked, axis, _ = key
        yield f"{kind} | {checked} | {axis}", _calibrated

    pooled = {name: _pooled(_calibrations(folds)) for name, folds in report.calibration.items()}
    return _side_by_side("kind | error | axis", pooled, rows)


def _side_by_side(
    head: str,
    pooled: Mapping[str, dict[_Key, list[float]]],
    rows: Callable[[_Key], Iterable[_Row]],
) -> list[str]:
    """A table with a column a variant, empty where nothing was measured for it.

    Args:
        head: titles of the cells before.
        pooled: by variant, what was measured.
        rows: of a key: cells before, and what is shown of the values.
    """
    lines = [
        f"| {head} | {' | '.join(pooled)} |",
        "|" + "---|" * (head.count("|") + 1 + len(pooled)),
    ]
    for key in next(iter(pooled.values()), {}):
        for cells, show in rows(key):
            values = (show(found[key]) if key in found else "" for found in pooled.values())
            lines.append(f"| {cells} | {' | '.join(values)} |")
    return lines


def _value(place: int, values: list[float]) -> str:
    return f"{values[place]:.4f}"


def _calibrated(values: list[float]) -> str:
    shares = " ".join(f"{100 * share:.0f}" for share in values[1:])
    return f"{values[0]:.2f} ({shares})"


def _errors(folds: Iterable[dict[str, list[FilterError]]]) -> Iterator[_Measured]:
    for fold in folds:
        for kind, of_kind in fold.items():
            for e in of_kind:
                if e.count:
                    yield (kind, e.stride, e.age, e.frames_ahead), e.count, (e.plan_m,)


def _dense_errors(folds: Iterable[Errors]) -> Iterator[_Measured]:
    for fold in folds:
        for name, e in fold.items():
            yield (name, 0, 0, 0), e.count, (e.plan_m, e.along_m, e.across_m, e.up_m)


def _calibrations(folds: Iterable[dict[str, list[Calibration]]]) -> Iterator[_Measured]:
    for fold in folds:
        for kind, of_kind in fold.items():
            for c in of_kind:
                if c.count:
                    yield (kind, c.checked, c.axis, 0), c.count, (c.mean_square, *c.within)


def _pooled(measured: Iterable[_Measured]) -> dict[_Key, list[float]]:
    """Values of all folds together, each weighted by its boxes."""
    total: dict[_Key, list[float]] = {}
    for key, count, values in measured:
        weighted = [count, *(value * count for value in values)]
        total[key] = [a + b for a, b in zip(total.get(key, [0.0] * 5), weighted, strict=False)]
    return {key: [value / sums[0] for value in sums[1:]] for key, sums in total.items()}
