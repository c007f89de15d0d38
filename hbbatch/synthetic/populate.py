"""Who is in the city when a drive begins."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import BOX_SIZE, FloatArray
from hbbatch.synthetic.city import (
    City,
    Route,
    random_junctions,
    random_route,
    random_walk_on_pavement,
    street,
)
from hbbatch.synthetic.population import Drivers, IntArray, Population, Walkers
from hbbatch.synthetic.settings import CAR, CYCLIST, PEDESTRIAN, TRUCK, TrafficSettings

EGO_SIZE_M: Final = (4.6, 1.85, 1.5)
_SIZE_M: Final = {
    CAR: ((4.3, 1.8, 1.55), 0.07),
    TRUCK: ((8.5, 2.4, 3.1), 0.12),
    CYCLIST: ((1.75, 0.65, 1.7), 0.05),
    PEDESTRIAN: ((0.75, 0.65, 1.72), 0.08),
}
"""Mean length, width, height, and relative standard deviation, by class."""

_LANE_STANDING_SHARE: Final = 0.05
_FASTEST_M_S: Final = 14.0
_ROOM_M: Final = 11.0


def populate(
    city: City, settings: TrafficSettings, duration_s: float, rng: np.random.Generator
) -> Population:
    """Put everybody somewhere with a way to go for `duration_s`."""
    parked, parked_codes = _park(city, settings, rng)
    in_lane = parked[:, :2]
    count = 1 + settings.moving_vehicles + settings.cyclists
    codes = np.where(rng.random(count) < settings.truck_share, TRUCK, CAR)
    codes[0] = CAR
    codes[count - settings.cyclists :] = CYCLIST
    drivers = _place_drivers(city, codes, in_lane, duration_s, rng)
    return Population(drivers, parked, parked_codes, _walkers(city, settings, duration_s, rng))


def _park(
    city: City, settings: TrafficSettings, rng: np.random.Generator
) -> tuple[FloatArray, IntArray]:
    boxes: list[FloatArray] = []
    codes = np.where(rng.random(settings.parked_vehicles) < settings.truck_share, TRUCK, CAR)
    kept = []
    for code in codes:
        box = _parked_box(city, int(code), rng)
        if all(np.hypot(*(box[:2] - other[:2])) > (box[3] + other[3]) / 2 + 0.8 for other in boxes):
            boxes.append(box)
            kept.append(int(code))
    return np.array(boxes).reshape(-1, BOX_SIZE), np.array(kept, dtype=np.int64)


def _parked_box(city: City, code: int, rng: np.random.Generator) -> FloatArray:
    size = _random_size(code, rng)
    in_lane = rng.random() < _LANE_STANDING_SHARE
    edge = city.roadway_m - 0.2 if in_lane else city.roadway_m + 0.3 + size[1] / 2
    start, end = random_junctions(city.settings.blocks, 2, rng)
    plan = street(city, start, end, edge)
    row = int(rng.integers(8, len(plan) - 22))
    here, ahead = city.to_world(plan[row : row + 2])
    yaw = np.arctan2(*(ahead - here)[::-1]) + rng.normal(0, 0.03)
    return np.array([*here, 0.0, *size, yaw])


def _random_size(code: int, rng: np.random.Generator) -> FloatArray:
    mean, spread = _SIZE_M[code]
    common = rng.normal(1, spread)
    size: FloatArray = np.array(mean) * np.clip(common + rng.normal(0, spread / 3, 3), 0.75, 1.35)
    return size


def _place_drivers(
    city: City, codes: IntArray, standing: FloatArray, duration_s: float, rng: np.random.Generator
) -> Drivers:
    """Drivers on random routes, none on top of another; who finds no room stays away."""
    taken = list(standing)
    reach_m = max(_FASTEST_M_S, 1.15 * city.settings.speed_limit_m_s) * duration_s
    routes, starts, kept = [], [], []
    for code in codes:
        for _ in range(5):
            route = random_route(city, reach_m, _from_centre(city, code, rng), rng)
            place = _free_place(route, taken, rng)
            if place is not None:
                taken.append(route.points[int(place)])
                routes.append(route)
                starts.append(place)
                kept.append(code)
                break
    return _drivers(city, np.array(kept), routes, np.array(starts), rng)


def _free_place(route: Route, taken: list[FloatArray], rng: np.random.Generator) -> float | None:
    """A distance along the first street of a route with room for a vehicle, if one is found."""
    others = np.array(taken).reshape(-1, 2)
    for place in rng.uniform(4, 0.8 * route.stops[0], 5):
        if (np.linalg.norm(others - route.points[int(place)], axis=1) > _ROOM_M).all():
            return float(place)
    return None


def _from_centre(city: City, code: int, rng: np.random.Generator) -> float:
    if code == CYCLIST:
        return city.roadway_m - 0.6
    lane = int(rng.integers(city.settings.lanes))
    return (lane + 0.5) * city.roadway_m / city.settings.lanes


def _drivers(
    city: City, codes: IntArray, routes: list[Route], starts: FloatArray, rng: np.random.Generator
) -> Drivers:
    sizes = np.array([_random_size(int(code), rng) for code in codes])
    sizes[0] = EGO_SIZE_M
    points = _padded([route.points for route in routes], 2)
    tangents = np.gradient(points, axis=1)
    tangents /= np.maximum(np.linalg.norm(tangents, axis=2, keepdims=True), 1e-9)
    headings = np.unwrap(np.arctan2(tangents[..., 1], tangents[..., 0]), axis=1)
    driver, row = np.arange(len(codes)), starts.astype(np.int64)
    cycling = codes == CYCLIST
    speed = np.where(cycling, rng.uniform(3.5, 6.0, len(codes)), city.settings.speed_limit_m_s)
    desired = np.where(codes == TRUCK, 0.85, 1.0) * speed * rng.uniform(0.8, 1.1, len(codes))
    return Drivers(
        class_codes=codes,
        length=sizes[:, 0],
        width=sizes[:, 1],
        height=sizes[:, 2],
        routes=points,
        tangents=tangents,
        curvature=np.maximum(np.abs(np.gradient(headings, axis=1)), 1e-4),
        stops=_padded([route.stops[:, None] for route in routes], 1, np.inf)[..., 0],
        signals=_padded([route.signals for route in routes], 3).astype(np.int64),
        desired=desired,
        rear=points[driver, row].copy(),
        yaw=headings[driver, row].copy(),
        speed=desired * rng.uniform(0.0, 0.8, len(codes)),
        progress=starts.copy(),
        offset=np.zeros(len(codes)),
    )


def _padded(
    rows: list[NDArray[np.generic]], columns: int, value: float | None = None
) -> FloatArray:
    """Arrays of unequal length side by side; the last row repeated, or `value`, fills up."""
    longest = max(map(len, rows), default=2)
    filled = np.zeros((len(rows), longest, columns))
    for target, row in zip(filled, rows, strict=True):
        target[: len(row)] = row
        target[len(row) :] = row[-1] if value is None else value
    return filled


def _walkers(
    city: City, settings: TrafficSettings, duration_s: float, rng: np.random.Generator
) -> Walkers:
    count = settings.pedestrians
    ways = [random_walk_on_pavement(city, 2.2 * duration_s + 5, rng) for _ in range(count)]
    size = np.array([_random_size(PEDESTRIAN, rng) for _ in range(count)]).reshape(-1, 3)
    desired = rng.uniform(0.7, 1.7, count) * (rng.random(count) > 0.1)
    return Walkers(
        ways=_padded([way for way, _ in ways], 2),
        roadway=_padded([roadway[:, None] for _, roadway in ways], 1)[..., 0].astype(bool),
        size=size,
        desired=desired,
        speed=desired.copy(),
        pace=np.ones(count),
        progress=np.zeros(count),
    )
