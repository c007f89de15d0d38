"""The ground that simulated traffic moves on: streets, lanes, junctions, blocks of houses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.synthetic.settings import TrafficSettings

LANE_WIDTH_M: Final = 3.5
PARKING_WIDTH_M: Final = 2.4
PAVEMENT_WIDTH_M: Final = 3.0
_BEND_LENGTH_M: Final = 230.0
_HILL_LENGTH_M: Final = 150.0
_STEP_M: Final = 1.0

Node = tuple[int, int]


@dataclass(frozen=True)
class Route:
    """A way through the city, sampled every metre.

    Attributes:
        points: `(n, 2)` world metres.
        stops: distance along the route of each stop line, `(k,)`.
        signals: `(k, 3)` junction column and row, and direction of arrival 0..3, of each stop line.
    """

    points: FloatArray
    stops: FloatArray
    signals: NDArray[np.int64]


@dataclass(frozen=True)
class City:
    """A square grid of streets, bent by a smooth map so that no street is straight.

    Grid coordinates are metres on the unbent plan with junctions at multiples of the block length;
    `to_world` bends them.
    """

    settings: TrafficSettings
    phase_rad: tuple[float, float, float, float]

    @property
    def roadway_m(self) -> float:
        """From the middle of a street to the edge of its outermost lane."""
        return self.settings.lanes * LANE_WIDTH_M

    @property
    def pavement_m(self) -> float:
        """From the middle of a street to the middle of its pavement."""
        return self.roadway_m + PARKING_WIDTH_M + PAVEMENT_WIDTH_M / 2

    @property
    def extent_m(self) -> float:
        """Length of a side of the square, on the plan."""
        return self.settings.blocks * self.settings.block_length_m

    def to_world(self, plan: FloatArray) -> FloatArray:
        """Points `(n, 2)` of the plan in the world, metres."""
        wave = 2 * np.pi / _BEND_LENGTH_M
        shift_x = self.settings.bend_m * np.sin(wave * plan[:, 1] + self.phase_rad[0])
        shift_y = self.settings.bend_m * np.sin(wave * plan[:, 0] + self.phase_rad[1])
        return plan + np.stack([shift_x, shift_y], axis=1)

    def ground_m(self, points: FloatArray) -> FloatArray:
        """Height of the ground at world points `(n, 2)`, `(n,)`."""
        wave = 2 * np.pi / _HILL_LENGTH_M
        along = np.sin(wave * points[:, 0] + self.phase_rad[2])
        height: FloatArray = (
            0.5 * self.settings.hill_m * (along + np.sin(wave * points[:, 1] + self.phase_rad[3]))
        )
        return height

    def ground_slope(self, points: FloatArray) -> FloatArray:
        """Gradient of the ground at world points `(n, 2)`, `(n, 2)`."""
        wave = 2 * np.pi / _HILL_LENGTH_M
        phase = np.array(self.phase_rad[2:])
        slope: FloatArray = 0.5 * self.settings.hill_m * wave * np.cos(wave * points + phase)
        return slope

    def house_blocks(self) -> FloatArray:
        """Corners of the blocks of houses between the streets, world, `(m, 4, 2)`."""
        inset = self.pavement_m + PAVEMENT_WIDTH_M / 2 + self.settings.house_setback_m
        low = np.arange(self.settings.blocks) * self.settings.block_length_m + inset
        high = low + self.settings.block_length_m - 2 * inset
        corners = [
            [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
            for x0, x1 in zip(low, high, strict=True)
            for y0, y1 in zip(low, high, strict=True)
        ]
        return self.to_world(np.array(corners).reshape(-1, 2)).reshape(-1, 4, 2)

    def is_roadway(self, plan: FloatArray) -> NDArray[np.bool_]:
        """Whether plan points `(n, 2)` lie where vehicles drive, `(n,)`."""
        block = self.settings.block_length_m
        to_street = np.abs((plan + block / 2) % block - block / 2)
        return np.asarray((to_street < self.roadway_m).any(axis=1))


def make_city(settings: TrafficSettings, rng: np.random.Generator) -> City:
    """A city with its own bends and hills."""
    a, b, c, d = rng.uniform(0, 2 * np.pi, 4)
    return City(settings, (float(a), float(b), float(c), float(d)))


def random_route(
    city: City, length_m: float, from_centre_m: float, rng: np.random.Generator
) -> Route:
    """A drive in a lane, turning or not at each junction.

    Args:
        city: where.
        length_m: least length.
        from_centre_m: distance to the right of the middle of the street.
        rng: source of chance.
    """
    block = city.settings.block_length_m
    nodes = random_junctions(city.settings.blocks, 3 + int(1.3 * length_m / block), rng)
    pieces: list[FloatArray] = []
    stop_rows, signals = [], []
    for before, node, after in zip(nodes, nodes[1:], nodes[2:], strict=False):
        here = street(city, before, node, from_centre_m)
        pieces.append(here)
        stop_rows.append(sum(map(len, pieces)) - 1)
        signals.append((*node, _heading(before, node)))
        pieces.append(_turn(here, street(city, node, after, from_centre_m)))
    world = city.to_world(np.concatenate(pieces))
    distance = _distance_along(world)
    return Route(_resample(world, distance), distance[stop_rows], np.array(signals, dtype=np.int64))


def random_walk_on_pavement(
    city: City, length_m: float, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """A pedestrian's way along a street, crossing it now and then.

    Returns:
        `(n, 2)` world points every half metre, and whether each lies on a roadway.
    """
    along_x = bool(rng.integers(2))
    middle = rng.integers(city.settings.blocks + 1) * city.settings.block_length_m
    along, side = rng.uniform(0, city.extent_m), float(rng.choice([-1.0, 1.0]))
    direction = 1.0 if along < city.extent_m / 2 else -1.0
    aside = city.pavement_m + rng.uniform(-1.0, 1.0)
    corners = [(along, side * aside)]
    walked = 0.0
    while walked < length_m:
        stretch = rng.uniform(15, 60)
        along += direction * stretch
        corners.append((along, side * aside))
        walked += stretch
        if rng.random() < 0.5:
            side = -side
            corners.append((along, side * aside))
            walked += 2 * aside
    plan = np.array(corners) + np.array([0.0, middle])
    plan = _resample(plan, _distance_along(plan), 0.5)
    plan = plan if along_x else plan[:, ::-1]
    return _smooth(city.to_world(plan)), city.is_roadway(plan)


def random_junctions(blocks: int, length: int, rng: np.random.Generator) -> list[Node]:
    """Junctions of a walk that never turns back."""
    column, row = (int(n) for n in rng.integers(0, blocks + 1, 2))
    walk: list[Node] = [(column, row)]
    while len(walk) < length:
        column, row = walk[-1]
        around = [(column + 1, row), (column, row + 1), (column - 1, row), (column, row - 1)]
        inside = [n for n in around if min(n) >= 0 and max(n) <= blocks]
        onward = [n for n in inside if len(walk) < 2 or n != walk[-2]]
        walk.append(onward[int(rng.integers(len(onward)))])
    return walk


def _heading(before: Node, after: Node) -> int:
    """0 east, 1 north, 2 west, 3 south."""
    return {(1, 0): 0, (0, 1): 1, (-1, 0): 2, (0, -1): 3}[
        (after[0] - before[0], after[1] - before[1])
    ]


def street(city: City, before: Node, after: Node, from_centre_m: float) -> FloatArray:
    """Plan points every metre from one junction's exit to the next one's stop line."""
    block = city.settings.block_length_m
    start, end = np.array(before) * block, np.array(after) * block
    ahead = (end - start) / block
    right = np.array([ahead[1], -ahead[0]])
    clear = city.roadway_m + 5.0
    steps = np.arange(clear, block - clear, _STEP_M)[:, None]
    points: FloatArray = start + ahead * steps + right * from_centre_m
    return points


def _turn(before: FloatArray, onward: FloatArray) -> FloatArray:
    """A Bézier curve over a junction, tangent to both streets."""
    start, end = before[-1], onward[0]
    reach = 0.45 * np.linalg.norm(end - start)
    leave = start + reach * (before[-1] - before[-2])
    join = end - reach * (onward[1] - onward[0])
    t = np.linspace(0, 1, 40)[1:-1, None]
    curve: FloatArray = (
        (1 - t) ** 3 * start + 3 * (1 - t) ** 2 * t * leave + 3 * (1 - t) * t**2 * join + t**3 * end
    )
    return curve


def _distance_along(points: FloatArray) -> FloatArray:
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    distance: FloatArray = np.concatenate([[0.0], np.cumsum(steps)])
    return distance


def _resample(points: FloatArray, distance: FloatArray, step_m: float = _STEP_M) -> FloatArray:
    at = np.arange(0, distance[-1], step_m)
    return np.stack([np.interp(at, distance, points[:, i]) for i in (0, 1)], axis=1)


def _smooth(points: FloatArray) -> FloatArray:
    """A moving mean over five points, so that nobody turns on the spot."""
    padded = np.pad(points, ((2, 2), (0, 0)), mode="edge")
    return np.stack([np.convolve(padded[:, i], np.full(5, 0.2), "valid") for i in (0, 1)], axis=1)
