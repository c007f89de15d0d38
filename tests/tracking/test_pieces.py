"""Sequences cut in silence say what they say uncut."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
import pytest

from hbbatch.config import ManagementSettings, TrackSettings
from hbbatch.model.weights_files import open_weights
from hbbatch.tracking.engine import stepping
from hbbatch.tracking.frames import SequenceFrames
from hbbatch.tracking.lockstep import LockStep
from hbbatch.tracking.pieces import Done, Piece, cut, joined
from hbbatch.tracking.schedule import schedule
from tests.tracking.drives import car, passing_cars, sequence

PATIENCE = ManagementSettings(max_misses=22, max_misses_unconfirmed=5)
CARS = [[car(0.5 * t), car(0.5 * t, 8.0)] for t in range(10)]


def stretches(drive: list[list[list[float]]]) -> list[tuple[int, int]]:
    pieces = cut([sequence(drive)], PATIENCE)
    return [(piece.first_frame, piece.frames.frame_count) for piece in pieces]


@pytest.mark.parametrize(
    ("silence", "found"), [(21, [(0, 41)]), (22, [(0, 32), (32, 10)]), (30, [(0, 32), (40, 10)])]
)
def test_a_sequence_is_cut_where_all_tracks_must_have_died(
    silence: int, found: list[tuple[int, int]]
) -> None:
    assert stretches([*CARS, *[[]] * silence, *CARS]) == found


def test_silence_before_and_after_is_not_stepped() -> None:
    assert stretches([*[[]] * 50, *CARS, *[[]] * 50]) == [(50, 32)]
    assert stretches([[]] * 50) == [(0, 0)]
    assert stretches([]) == [(0, 0)]


def test_the_longest_patience_counts() -> None:
    stubborn = ManagementSettings(max_misses=3, max_misses_unconfirmed=12)
    assert len(cut([sequence([*CARS, *[[]] * 11, *CARS])], stubborn)) == 1
    assert len(cut([sequence([*CARS, *[[]] * 12, *CARS])], stubborn)) == 2


@pytest.mark.parametrize("name", ["kalman", "hybrid"])
@pytest.mark.parametrize("protocol", ["gap_filled", "online"])
def test_joined_pieces_say_what_the_whole_says(name: str, protocol: str) -> None:
    output = {"protocol": protocol, "max_coasted": 100, "min_confidence": 0}
    settings = TrackSettings.model_validate({"filter": name, "output": output})
    group = [with_silences(seed) for seed in range(3)] + [sequence([[]] * 30), sequence([])]
    pieces = cut(group, settings.management)
    assert len(pieces) > len(group)
    whole = {number: tracks for number, tracks, _ in steps(group, settings)}
    parts = {number: tracks for number, tracks, _ in joined(pieces, steps(of(pieces), settings))}
    assert parts.keys() == whole.keys() == set(range(len(group)))
    for number, tracks in whole.items():
        for column, values in vars(tracks).items():
            found = vars(parts[number])[column]
            assert found == pytest.approx(values, abs=1e-4, nan_ok=True), column


def test_a_sequence_gets_the_time_of_all_its_pieces() -> None:
    group, settings = [with_silences(0)], TrackSettings.model_validate({"filter": "kalman"})
    pieces = cut(group, settings.management)
    done = list(steps(of(pieces), settings))
    ((_, _, seconds),) = joined(pieces, done)
    assert seconds.update == pytest.approx(sum(part.update for _, _, part in done))


def with_silences(seed: int) -> SequenceFrames:
    """Three drives with silences between them, long and short ones."""
    drives = [passing_cars(seed + 10 * part, frames=20 + seed) for part in range(3)]
    frames = [
        [drive.boxes[row].tolist() for row in range(start, stop)]
        for drive in drives
        for start, stop in chain(
            zip(drive.offsets[:-1], drive.offsets[1:], strict=True), [(0, 0)] * (15 + 10 * seed)
        )
    ]
    return sequence(frames, name=str(seed))


def of(pieces: Sequence[Piece]) -> list[SequenceFrames]:
    return [piece.frames for piece in pieces]


def steps(group: Sequence[SequenceFrames], settings: TrackSettings) -> list[Done]:
    file = open_weights(settings.filter, None, ["car"])
    plan, kinds = schedule(group), np.array(file.kind_codes)
    make = stepping(file, "cpu")
    return list(LockStep(plan, make(plan, kinds[plan.class_codes], settings)).run())
