"""The compiled bank against the torch modules, over whole drives and all settings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hbbatch.config import TrackSettings
from hbbatch.model.weights_files import open_weights
from hbbatch.tracking.association import Pairs
from hbbatch.tracking.frames import SequenceFrames
from hbbatch.tracking.lockstep import LockStep
from hbbatch.tracking.packed_bank import packed_banks
from hbbatch.tracking.rows import RowTable
from hbbatch.tracking.schedule import schedule
from hbbatch.tracking.tensor_bank import tensor_banks
from hbbatch.tracking.tracks import SequenceTracks
from tests.tracking.drives import passing_cars

ONLINE = {"protocol": "online", "max_coasted": 10}
SETTINGS = {
    "default": {},
    "coasting": {"output": ONLINE},
    "damped": {"output": ONLINE, "damping": {"enabled": True}},
    "patient": {"management": {"max_misses": 40, "max_misses_unconfirmed": 20}},
    "far": {"association": {"cost": "l2"}},
}

pytestmark = pytest.mark.usefixtures("kernels")


def tracks(
    group: Sequence[SequenceFrames], settings: TrackSettings, compiled: bool
) -> dict[int, SequenceTracks]:
    file = open_weights(settings.filter, settings.weights, settings.classes)
    kinds, plan = np.array(file.kind_codes), schedule(group)
    make = packed_banks(file) if compiled else tensor_banks(file, "cpu")
    bank = make(plan, kinds[plan.class_codes])
    return {n: found for n, found, _ in LockStep(plan, bank, kinds, settings).run()}


def assert_same(group: Sequence[SequenceFrames], settings: TrackSettings) -> None:
    fast, slow = (tracks(group, settings, compiled) for compiled in (True, False))
    assert fast.keys() == slow.keys()
    for number, found in fast.items():
        expected = slow[number]
        for name in ("frame_index", "track_id", "class_code", "state", "detection_row"):
            assert getattr(found, name).tolist() == getattr(expected, name).tolist()
        assert found.score == pytest.approx(expected.score, nan_ok=True, abs=0)
        apart = found.boxes - expected.boxes
        apart[:, 6] = np.sin(apart[:, 6] / 2)
        assert np.abs(apart).max(initial=0.0) < 1e-4
        assert found.velocity_m_s == pytest.approx(expected.velocity_m_s, abs=1e-2)


@pytest.mark.parametrize("name", ["kalman", "hybrid"])
@pytest.mark.parametrize("changes", SETTINGS.values(), ids=SETTINGS)
def test_both_banks_track_alike(name: str, changes: dict[str, object]) -> None:
    group = [passing_cars(seed, 40 + 10 * seed, cars=6 + seed) for seed in range(5)]
    assert_same(group, TrackSettings.model_validate({"filter": name, **changes}))


@pytest.mark.parametrize("name", ["kalman", "hybrid"])
def test_and_so_they_do_on_real_drives(test_data: Path, name: str) -> None:
    from tests.tracking.real_drives import real_frames

    group = [real_frames(test_data, s) for s in ("0000", "0003", "0012", "0014")]
    assert_same(group, TrackSettings.model_validate({"filter": name}))


def test_rows_settle_alike_compiled_or_not() -> None:
    """Who is matched, lives on or dies is the same; in which order is the compiled one's choice."""
    rng = np.random.default_rng(0)
    tables = RowTable(), RowTable()
    for step in range(60):
        born = np.arange(10 * step, 10 * step + rng.integers(0, 10))
        for table in tables:
            table.append(born, born % 3, born % 5, 5)
        names = tables[0].first.tolist()
        lookup = {first: row for row, first in enumerate(tables[1].first.tolist())}
        matched = rng.permutation(len(tables[0]))[: rng.integers(0, len(tables[0]) // 2 + 1)]
        pairs = Pairs(matched, 1000 + matched)
        others = np.array([lookup[names[row]] for row in matched], np.int64)
        order, detections, alive = tables[0].settle(pairs, 9)
        expected, same, expected_alive = tables[1].settle_any(Pairs(others, pairs.detection), 9)
        assert alive == expected_alive
        assert sorted(order.tolist()) == list(range(len(order)))
        assert (detections == 1000 + order[: len(matched)]).all()
        assert (same == pairs.detection).all()
        in_place = int(np.count_nonzero(order == np.arange(len(order))))
        assert in_place >= len(order) - 2 * (len(matched) + len(order) - alive)
        for table, by in zip(tables, (order, expected), strict=True):
            table.arrange(by)
            table.truncate(alive)
        for name in ("first", "sequence", "block", "age", "misses"):
            found, wanted = (getattr(table, name)[table.first.argsort()] for table in tables)
            assert found.tolist() == wanted.tolist()
    assert len(tables[0]) > 20
