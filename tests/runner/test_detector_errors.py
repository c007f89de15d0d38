"""Statistics of detection errors: what was put in is found, whatever the frame rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hbbatch.boxes import wrap_angle
from hbbatch.runner.detector_errors import LAGS_S, detector_errors, markdown
from hbbatch.tracking.tracklets import Trajectories

NOISE_M = (0.2, 0.1, 0.05)
HALF_LIFE_S = 0.5


def driving(step_s: float, objects: int = 40, frames: int = 200) -> Trajectories:
    """Cars 15 m from the sensor in all directions; errors along the heading fade slowly."""
    rng = np.random.default_rng(3)
    count = objects * frames
    heading = np.repeat(rng.uniform(-np.pi, np.pi, objects), frames)
    keep = 0.5 ** (step_s / HALF_LIFE_S)
    along = np.zeros((objects, frames))
    along[:, 0] = rng.standard_normal(objects)
    for frame in range(1, frames):
        fresh = rng.standard_normal(objects)
        along[:, frame] = keep * along[:, frame - 1] + np.sqrt(1 - keep**2) * fresh
    along_m, across_m = NOISE_M[0] * along.ravel(), NOISE_M[1] * rng.standard_normal(count)
    truth = np.zeros((count, 7))
    truth[:, 3:] = np.array([4.5, 1.8, 1.5, 0.0])
    truth[:, 6] = heading
    measured = truth.copy()
    measured[:, 0] += along_m * np.cos(heading) - across_m * np.sin(heading)
    measured[:, 1] += along_m * np.sin(heading) + across_m * np.cos(heading)
    measured[:, 2] += NOISE_M[2] * rng.standard_normal(count)
    backwards = rng.random(count) < 0.1
    measured[:, 6] = wrap_angle(heading + np.pi * backwards)
    first = np.arange(objects) * frames
    dt_s = np.full(count, step_s)
    dt_s[first] = 0.0
    return Trajectories(
        first_row=first,
        length=np.full(objects, frames),
        kind_code=np.zeros(objects, np.int64),
        truth=truth,
        measured=measured,
        seen=np.ones(count, bool),
        sight_m=np.tile([15.0, 0.0, 0.0], (count, 1)),
        score=np.ones(count),
        dt_s=dt_s,
    )


@pytest.mark.parametrize("step_s", [0.05, 0.1])
def test_what_was_put_in_is_found(step_s: float) -> None:
    found = detector_errors(driving(step_s), "vehicle")
    assert (found.along_near_m, found.across_near_m, found.up_near_m) == pytest.approx(
        NOISE_M, rel=0.1
    )
    assert found.backwards == pytest.approx(0.1, abs=0.02)
    assert found.yaw_near_rad == pytest.approx(0.0, abs=1e-9)
    assert found.tails == pytest.approx(1.0, abs=0.05)
    expected = [0.5 ** (lag_s / HALF_LIFE_S) for lag_s in LAGS_S]
    assert found.correlation == pytest.approx(expected, abs=0.08)


def test_misses_in_bursts_are_told_from_single_ones() -> None:
    whole = driving(0.1)
    frame = np.arange(len(whole.seen)) % 200
    single = detector_errors(replace(whole, seen=frame % 4 != 2), "vehicle")
    bursts = detector_errors(replace(whole, seen=frame % 40 < 30), "vehicle")
    assert (single.found, bursts.found) == (0.75, 0.75)
    assert single.missed_again == 0.0
    assert bursts.missed_again == pytest.approx(0.9, abs=0.02)


def test_a_kind_that_is_not_there_leaves_the_table_whole() -> None:
    with np.errstate(all="raise"):
        columns = {kind: detector_errors(driving(0.1), kind) for kind in ("vehicle", "cyclist")}
    table = markdown(columns)
    assert "| | vehicle | cyclist |" in table
    assert "| detections | 8,000 | 0 |" in table
