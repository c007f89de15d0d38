"""Who is in the city: drivers with routes, parked vehicles, pedestrians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import BOX_SIZE, HEIGHT, LENGTH, YAW, FloatArray, Z
from hbbatch.synthetic.city import (
    City,
    Route,
    random_junctions,
    random_route,
    random_walk_on_pavement,
    street,
)
from hbbatch.synthetic.settings import CAR, CYCLIST, PEDESTRIAN, TRUCK, TrafficSettings

IntArray = NDArray[np.int64]

EGO_SIZE_M: Final = (4.6, 1.85, 1.5)
_SIZE_M: Final = {
    CAR: ((4.3, 1.8, 1.55), 0.07),
    TRUCK: ((8.5, 2.4, 3.1), 0.12),
    CYCLIST: ((1.75, 0.65, 1.7), 0.05),
    PEDESTRIAN: ((0.75, 0.65, 1.72), 0.08),
}
"""Mean length, width, height, and relative standard deviation, by class."""

_PAVEMENT_STEP_M: Final = 0.5
_LANE_STANDING_SHARE: Final = 0.05
_FASTEST_M_S: Final = 14.0
_ROOM_M: Final = 11.0


@dataclass
class Drivers:
    """Vehicles and cyclists in traffic; the ego vehicle is the first.

    Attributes:
        class_codes: `(n,)`.
        length, width, height: `(n,)` metres.
        routes, tangents: `(n, points, 2)` a point a metre, the last repeated.
        curvature: `(n, points)` 1/m.
        stops: `(n, k)` distance of stop lines along the route, infinite where there is none.
        signals: `(n, k, 3)` junction and direction of arrival of each.
        desired: `(n,)` speed on an empty straight street, m/s.
        rear: `(n, 2)` rear axle, world.
        yaw, speed: `(n,)`.
        progress: `(n,)` distance of the rear axle along the route.
        offset: `(n,)` metres left of the route that are held just now.
    """

    class_codes: IntArray
    length: FloatArray
    width: FloatArray
    height: FloatArray
    routes: FloatArray
    tangents: FloatArray
    curvature: FloatArray
    stops: FloatArray
    signals: IntArray
    desired: FloatArray
    rear: FloatArray
    yaw: FloatArray
    speed: FloatArray
    progress: FloatArray
    offset: FloatArray

    @property
    def wheelbase(self) -> FloatArray:
        """Distance between the axles, metres."""
        return 0.6 * self.length

    @property
    def front_m(self) -> FloatArray:
        """From the rear axle to the front bumper."""
        return self.wheelbase / 2 + self.length / 2

    def centres(self) -> FloatArray:
        """Middle of each vehicle, `(n, 2)`."""
        heading = np.stack([np.cos(self.yaw), np.sin(self.yaw)], axis=1)
        centre: FloatArray = self.rear + heading * (self.wheelbase / 2)[:, None]
        return centre

    def _rows(self, ahead: IntArray) -> tuple[IntArray, IntArray]:
        rows = self.progress.astype(np.int64)[:, None] + ahead
        return np.arange(len(rows))[:, None], np.clip(rows, 0, self.routes.shape[1] - 1)

    def route_at(self, ahead: IntArray) -> tuple[FloatArray, FloatArray]:
        """Points and tangents of each route at metres ahead of the rear axle, `(n, k, 2)`."""
        rows = self._rows(ahead)
        return self.routes[rows], self.tangents[rows]

    def curvature_at(self, ahead: IntArray) -> FloatArray:
        """Curvature of each route at metres ahead of the rear axle, `(n, k)`."""
        return self.curvature[self._rows(ahead)]

    def point_ahead(self, ahead_m: FloatArray) -> FloatArray:
        """The point `(n, 2)` to steer to, the driver's distance `(n,)` ahead."""
        exact = np.clip(self.progress + ahead_m, 0, self.routes.shape[1] - 2)
        row, share = exact.astype(np.int64), (exact % 1.0)[:, None]
        driver = np.arange(len(row))
        point = (1 - share) * self.routes[driver, row] + share * self.routes[driver, row + 1]
        tangent = self.tangents[driver, row]
        left = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        return point + left * self.offset[:, None]

    def next_stop(self) -> tuple[FloatArray, IntArray]:
        """Metres from the front bumper to the next stop line `(n,)`, and its signal `(n, 3)`."""
        distance = self.stops - (self.progress + self.front_m)[:, None]
        following = np.where(distance > -1.0, distance, np.inf).argmin(axis=1)
        driver = np.arange(len(following))
        return distance[driver, following], self.signals[driver, following]

    def advance(self) -> None:
        """Find each rear axle's place along its route again, never going back."""
        points, tangents = self.route_at(np.arange(0, 5))
        offset = self.rear[:, None] - points
        nearest = (offset**2).sum(2).argmin(axis=1)
        driver = np.arange(len(nearest))
        past = (offset[driver, nearest] * tangents[driver, nearest]).sum(1)
        place = self.progress.astype(np.int64) + nearest + np.clip(past, -0.99, 0.99)
        self.progress = np.maximum(self.progress, place)


@dataclass
class Walkers:
    """Pedestrians.

    Attributes:
        ways: `(n, points, 2)` a point every half metre of each way, the last repeated.
        roadway: `(n, points)` whether it lies on a roadway.
        size: `(n, 3)` length, width, height.
        desired: `(n,)` mean speed.
        speed: `(n,)`.
        pace: `(n,)` speed as a share of the mean, varying.
        progress: `(n,)` metres along the way.
    """

    ways: FloatArray
    roadway: NDArray[np.bool_]
    size: FloatArray
    desired: FloatArray
    speed: FloatArray
    pace: FloatArray
    progress: FloatArray

    def positions(self, ahead_m: float = 0.0) -> FloatArray:
        """Where they are, or will be after `ahead_m` metres, `(n, 2)`."""
        exact = self._place(ahead_m)
        row, share = exact.astype(np.int64), (exact % 1.0)[:, None]
        walker = np.arange(len(row))
        position: FloatArray = (1 - share) * self.ways[walker, row]
        return position + share * self.ways[walker, row + 1]

    def on_roadway(self, ahead_m: float) -> NDArray[np.bool_]:
        """Whether they are, or will be after `ahead_m` metres, on a roadway, `(n,)`."""
        row = self._place(ahead_m).astype(np.int64)
        return np.asarray(self.roadway[np.arange(len(row)), row])

    def _place(self, ahead_m: float) -> FloatArray:
        last = self.ways.shape[1] - 2
        place: FloatArray = np.minimum((self.progress + ahead_m) / _PAVEMENT_STEP_M, last)
        return place


@dataclass
class Population:
    """Everybody, in the order drivers, parked vehicles, pedestrians.

    Attributes:
        drivers: in traffic.
        parked: `(n, 7)` boxes of parked vehicles, world.
        parked_codes: `(n,)` their classes.
        walkers: pedestrians.
    """

    drivers: Drivers
    parked: FloatArray
    parked_codes: IntArray
    walkers: Walkers

    @property
    def class_codes(self) -> IntArray:
        """Class of each agent."""
        walking = np.full(len(self.walkers.speed), PEDESTRIAN)
        return np.concatenate([self.drivers.class_codes, self.parked_codes, walking])

    @property
    def is_slow(self) -> NDArray[np.bool_]:
        """Who may be overtaken: cyclists and parked vehicles, not a queue at a signal."""
        return np.concatenate(
            [
                self.drivers.class_codes == CYCLIST,
                np.ones(len(self.parked), bool),
                np.zeros(len(self.walkers.speed), bool),
            ]
        )

    def boxes(self, city: City) -> FloatArray:
        """Boxes of all agents now, world, `(agents, 7)`."""
        drivers, walkers = self.drivers, self.walkers
        driving = np.zeros((len(drivers.yaw), BOX_SIZE))
        driving[:, :2] = drivers.centres()
        driving[:, LENGTH:YAW] = np.stack([drivers.length, drivers.width, drivers.height], axis=1)
        driving[:, YAW] = drivers.yaw
        walking = np.zeros((len(walkers.speed), BOX_SIZE))
        walking[:, :2] = walkers.positions()
        walking[:, LENGTH:YAW] = walkers.size
        ahead = walkers.positions(0.5) - walking[:, :2]
        walking[:, YAW] = np.arctan2(ahead[:, 1], ahead[:, 0])
        boxes = np.concatenate([driving, self.parked, walking])
        boxes[:, Z] = city.ground_m(boxes[:, :2]) + boxes[:, HEIGHT] / 2
        return boxes

    def speeds(self) -> FloatArray:
        """Speed of each agent, m/s."""
        standing = np.zeros(len(self.parked))
        return np.concatenate([self.drivers.speed, standing, self.walkers.speed])


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
    routes, starts, kept = [], [], []
    for code in codes:
        for _ in range(5):
            route = random_route(
                city, _FASTEST_M_S * duration_s, _from_centre(city, code, rng), rng
            )
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
