"""The compiled bank against the torch modules, over whole drives and all settings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hbbatch.config import TrackSettings
from hbbatch.model.weights_files import open_weights
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
    rng = np.random.default_rng(0)
    tables = RowTable(), RowTable()
    for step in range(60):
        born = np.arange(10 * step, 10 * step + rng.integers(0, 10))
        for table in tables:
            table.append(born, born % 3, born % 5, 5)
        count = len(tables[0])
        matched = rng.permutation(count)[: rng.integers(0, count // 2 + 1)]
        (order, alive), (expected, expected_alive) = (
            tables[0].settle(matched, 9),
            tables[1].settle_any(matched, 9),
        )
        assert order.tolist() == expected.tolist()
        assert alive == expected_alive
        for table in tables:
            table.arrange(order)
            table.truncate(alive)
        for name in ("first", "sequence", "block", "age", "misses"):
            assert getattr(tables[0], name).tolist() == getattr(tables[1], name).tolist()
    assert len(tables[0]) > 20
