"""Score cuts for a detector, from the tracks of a run without cuts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from hbbatch.dataset import Dataset, write_aside
from hbbatch.errors import DatasetError
from hbbatch.evaluation.persistence import ScoreCuts, score_cuts


@dataclass(frozen=True)
class CalibrationReport:
    """Cuts by class, classes with too few detections to tell, and the settings file written."""

    run: str
    cuts: dict[str, ScoreCuts]
    too_few: list[str]
    out: Path

    def settings(self) -> dict[str, Any]:
        """The cuts as settings of a run."""
        track = {name: c.track for name, c in self.cuts.items() if c.track is not None}
        local = {name: c.local for name, c in self.cuts.items() if c.local is not None}
        return {"output": {"min_track_score": track, "min_local_score": local}}


def calibrate(root: Path, out: Path, run: str | None = None) -> CalibrationReport:
    """Find score cuts without labels and write them as a settings file for `hbbatch track`.

    Args:
        root: dataset.
        out: YAML file to write.
        run: a run made without score cuts; default the latest.

    Raises:
        DatasetError: nothing was tracked, or no class has detections enough to tell.
        UsageError: no such run.
    """
    dataset = Dataset.open(root)
    chosen = dataset.existing_run(run)
    tables = [chosen.read_tracks(s) for s in dataset.sequence_ids() if chosen.tracks(s).is_file()]
    classes = sorted({name for t in tables for name in t["class_name"].unique().to_pylist()})
    found = {name: score_cuts(tables, name) for name in classes}
    cuts = {name: of_class for name, of_class in found.items() if of_class is not None}
    if not cuts:
        raise DatasetError(
            f"run {chosen.name}: too few detections to find score cuts. "
            "Track more sequences, or set output.min_track_score by hand."
        )
    too_few = [name for name in classes if name not in cuts]
    report = CalibrationReport(chosen.name, cuts, too_few, out)
    with write_aside(out) as aside:
        aside.write_text(yaml.safe_dump(report.settings()))
    return report
