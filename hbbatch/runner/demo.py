"""A simulated drive through the whole of hbbatch, held against the truth."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pyarrow.compute as pc

from hbbatch import schema
from hbbatch.config import OutputSettings, TrackSettings
from hbbatch.dataset import Dataset
from hbbatch.dataset.store import write_table
from hbbatch.errors import SequenceError, UsageError
from hbbatch.runner.evaluate import EvaluationReport, evaluate
from hbbatch.runner.ingest import ingest
from hbbatch.runner.track import TrackRequest, track
from hbbatch.synthetic.drive import Drive, simulate_drive
from hbbatch.synthetic.labels import labels_table
from hbbatch.synthetic.mcap import SENSOR_FRAME, write_mcap
from hbbatch.synthetic.settings import DriveSettings

LOG_NAME: Final = "drive.mcap"
DATASET_NAME: Final = "dataset"
SETTINGS: Final = TrackSettings(output=OutputSettings(min_track_score=0.45))
"""The defaults, with a score cut that fits the simulated detector, whose scores lie in 0..1."""


@dataclass(frozen=True)
class DemoReport:
    """What the demo made, and where.

    Attributes:
        log: the simulated drive's MCAP file.
        dataset: the dataset it was ingested into.
        sequence_id: what the drive is called there.
        run: name of the tracking run.
        evaluation: the tracks held against the truth.
        seconds: wall seconds of each step, by its name.
    """

    log: Path
    dataset: Path
    sequence_id: str
    run: str
    evaluation: EvaluationReport
    seconds: dict[str, float]


def demo(
    out_dir: Path, seed: int = 0, settings: TrackSettings = SETTINGS, duration_s: float = 40.0
) -> DemoReport:
    """Simulate a drive, write it as a log, and do with it what a user does with logs.

    Args:
        out_dir: folder to write to; what an earlier demo left there is replaced.
        seed: another seed is another city, traffic and detector's luck.
        settings: of the tracker.
        duration_s: length of the drive.

    Raises:
        UsageError: `out_dir` is a file.
        SequenceError: the drive could not be ingested or tracked.
        DatasetError: the folder cannot be written.
        WeightsError: the weights named in `settings` cannot be used.
        MissingExtraError: TrackEval is not installed.
    """
    if out_dir.exists() and not out_dir.is_dir():
        raise UsageError(f"{out_dir}: is a file. Name another folder with --out.")
    log, root = out_dir / LOG_NAME, out_dir / DATASET_NAME
    clock = _Clock()
    drive = simulate_drive(DriveSettings(duration_s=duration_s), seed)
    write_mcap(drive, log)
    clock.lap("simulate")
    ingested = ingest([log], root)
    _stop_on(ingested.errors)
    sequence_id = ingested.outcomes[0].sequence_id
    _write_truth(Dataset.open(root), sequence_id, drive)
    clock.lap("ingest")
    request = TrackRequest(root, settings, workers=1, command="hbbatch demo")
    tracked = track(request)
    _stop_on(list(tracked.failed.values()))
    clock.lap("track")
    evaluation = evaluate(root, tracked.run)
    clock.lap("evaluate")
    return DemoReport(log, root, sequence_id, tracked.run, evaluation, clock.seconds)


def _write_truth(dataset: Dataset, sequence_id: str, drive: Drive) -> None:
    """The labels table of the drive, and their number in the catalogue."""
    labels = labels_table(drive, SENSOR_FRAME)
    write_table(dataset.path("labels", sequence_id), labels, schema.LABELS)
    catalog = dataset.catalog()
    mine = pc.equal(catalog["sequence_id"], sequence_id)
    counts = pc.if_else(mine, labels.num_rows, catalog["labels"])
    column = catalog.schema.get_field_index("labels")
    dataset.write_catalog(catalog.set_column(column, "labels", counts))


def _stop_on(errors: list[str]) -> None:
    if errors:
        raise SequenceError(errors[0])


class _Clock:
    """Wall seconds between laps."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name], self._last = now - self._last, now
