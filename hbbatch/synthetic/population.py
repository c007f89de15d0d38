"""Who is in the city: drivers with routes, parked vehicles, pedestrians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import BOX_SIZE, HEIGHT, LENGTH, YAW, FloatArray, Z
from hbbatch.synthetic.city import City
from hbbatch.synthetic.settings import CYCLIST, PEDESTRIAN

IntArray = NDArray[np.int64]

_PAVEMENT_STEP_M: Final = 0.5


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
