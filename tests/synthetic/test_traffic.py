"""Simulated traffic obeys physics and the highway code, more or less."""

from __future__ import annotations

import numpy as np
import pytest

from hbbatch.boxes import HEIGHT, LENGTH, WIDTH, YAW, Z, wrap_angle
from hbbatch.overlap import footprint_intersection
from hbbatch.synthetic.city import City, make_city
from hbbatch.synthetic.populate import populate
from hbbatch.synthetic.population import Population
from hbbatch.synthetic.settings import CAR, PEDESTRIAN, TRUCK, TrafficSettings
from hbbatch.synthetic.traffic import TrafficHistory, simulate_traffic, step_drivers

STEP_S = 0.1
FRAMES = 300


def make_population(seed: int) -> tuple[City, Population]:
    rng = np.random.default_rng(seed)
    settings = TrafficSettings()
    city = make_city(settings, rng)
    return city, populate(city, settings, FRAMES * STEP_S, rng)


@pytest.fixture(scope="module")
def city() -> City:
    return make_population(1)[0]


@pytest.fixture(scope="module")
def history() -> TrafficHistory:
    city, population = make_population(1)
    return simulate_traffic(city, population, FRAMES, STEP_S, np.random.default_rng(2))


def movement(history: TrafficHistory) -> np.ndarray:
    """Displacement of each centre from frame to frame, `(frames - 1, agents, 2)`."""
    return np.diff(history.boxes[:, :, :2], axis=0)


def test_nobody_moves_faster_than_their_speed(history: TrafficHistory) -> None:
    distance = np.linalg.norm(movement(history), axis=2)
    assert history.speed_m_s.max() < 14.5
    # The middle of a vehicle swings a little wider than its rear axle in a bend.
    assert (distance <= 1.25 * history.speed_m_s[1:] * STEP_S + 0.02).all()


def test_vehicles_brake_and_accelerate_within_reason(history: TrafficHistory) -> None:
    driving = history.class_codes != PEDESTRIAN
    acceleration = np.diff(history.speed_m_s[:, driving], axis=0) / STEP_S
    assert acceleration.max() <= 2.0
    assert acceleration.min() >= -7.1
    assert np.quantile(acceleration, 0.01) > -4.0


def test_vehicles_head_where_they_go(history: TrafficHistory) -> None:
    driving = np.isin(history.class_codes, (CAR, TRUCK))
    moved = movement(history)[:, driving]
    fast = np.linalg.norm(moved, axis=2) > 2.0 * STEP_S
    course = np.arctan2(moved[..., 1], moved[..., 0])
    slip = np.abs(wrap_angle(course - history.boxes[:-1, driving, YAW]))[fast]
    assert np.median(slip) < 0.02
    assert slip.max() < 0.5


def test_vehicles_turn_stop_and_start_again(history: TrafficHistory) -> None:
    driving = np.isin(history.class_codes, (CAR, TRUCK))
    speed, yaw = history.speed_m_s[:, driving], np.unwrap(history.boxes[:, driving, YAW], axis=0)
    assert (np.ptp(yaw, axis=0) > 1.2).sum() >= 5
    stopped_first = (np.minimum.accumulate(speed, axis=0) < 0.1) & (speed > 4.0)
    assert stopped_first.any(axis=0).sum() >= 5


def test_vehicles_do_not_drive_through_one_another(history: TrafficHistory) -> None:
    first, second = np.triu_indices(history.boxes.shape[1], 1)
    deep = met = 0
    for boxes in history.boxes[::10]:
        apart = np.hypot(*(boxes[first, :2] - boxes[second, :2]).T)
        near = apart < 12.0
        a, b = boxes[first[near]], boxes[second[near]]
        smaller = np.minimum(a[:, LENGTH] * a[:, WIDTH], b[:, LENGTH] * b[:, WIDTH])
        share = footprint_intersection(a, b) / smaller
        deep += int((share > 0.2).sum())
        met += len(share)
    assert met > 1000
    assert deep / met < 0.005


def test_everybody_stands_on_the_ground(city: City, history: TrafficHistory) -> None:
    last = history.boxes[-1]
    np.testing.assert_allclose(last[:, Z] - last[:, HEIGHT] / 2, city.ground_m(last[:, :2]))


def test_drivers_pass_cyclists_and_parked_vehicles_on_the_left() -> None:
    city, population = make_population(3)
    widest = np.zeros(len(population.drivers.yaw))
    for frame in range(FRAMES):
        step_drivers(population, population.boxes(city), frame * STEP_S, STEP_S)
        widest = np.maximum(widest, population.drivers.offset)
    assert (widest[population.drivers.class_codes == CAR] > 0.5).sum() >= 3
    assert population.drivers.offset.min() > -0.1


def test_pedestrians_walk_and_some_cross_the_street(history: TrafficHistory) -> None:
    walking = history.class_codes == PEDESTRIAN
    assert 0.5 < np.median(history.speed_m_s[:, walking]) < 1.8
    _, population = make_population(1)
    assert population.walkers.roadway.any(axis=1).sum() >= 5
