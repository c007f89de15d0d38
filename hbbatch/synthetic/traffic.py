"""How vehicles, cyclists and pedestrians move through the city.

Vehicles and cyclists are kinematic bicycles that steer towards a point of their route (pure
pursuit; Coulter, 1992) and keep their distance by the Intelligent Driver Model (Treiber, Hennecke,
Helbing, 2000). Signals give one approach of a junction after the other its green.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray, wrap_angle
from hbbatch.synthetic.city import City
from hbbatch.synthetic.population import Population
from hbbatch.synthetic.settings import CYCLIST

_BEHIND_M: Final = 6
_AHEAD_M: Final = 65
_WINDOW: Final = np.concatenate([np.arange(-_BEHIND_M, 20, 2), np.arange(20, _AHEAD_M, 4)])
"""Where along its route a driver looks, metres from the rear axle; finer nearby."""
_STANDSTILL_GAP_M: Final = 2.0
_HEADWAY_S: Final = 1.2
_ACCELERATION: Final = 1.8
_BRAKING: Final = 2.5
_HARDEST_BRAKING: Final = 7.0
_LATERAL_ACCELERATION: Final = 2.2
_MARGIN_M: Final = 0.3
_PASSING_MARGIN_M: Final = 0.7
_GREEN_S: Final = 6.5
_PHASE_S: Final = 8.5
_FULL_LOCK_RAD: Final = 0.6


@dataclass(frozen=True)
class TrafficHistory:
    """Where everybody was; the ego vehicle is column 0.

    Attributes:
        boxes: `(frames, agents, 7)` world frame.
        speed_m_s: `(frames, agents)`.
        class_codes: `(agents,)` index into `settings.CLASS_NAMES`.
    """

    boxes: FloatArray
    speed_m_s: FloatArray
    class_codes: NDArray[np.int64]


@dataclass(frozen=True)
class _Surroundings:
    """All agents as seen along the route of each driver, `(drivers, agents)`.

    Attributes:
        ahead_m: along the route from the driver's rear axle to the agent's centre.
        aside_m: to the left of the route.
        half_length_m: half the extent along the route.
        half_width_m: half the extent across it.
        speed_m_s: along the route, at least 0.
        near: agents beside the next stretch of the route, without the driver.
    """

    ahead_m: FloatArray
    aside_m: FloatArray
    half_length_m: FloatArray
    half_width_m: FloatArray
    speed_m_s: FloatArray
    near: NDArray[np.bool_]


def simulate_traffic(
    city: City, population: Population, frame_count: int, step_s: float, rng: np.random.Generator
) -> TrafficHistory:
    """Let everybody move.

    Args:
        city: where.
        population: who, at the start; changed as they move.
        frame_count: frames to record, the start included.
        step_s: time between frames.
        rng: source of chance.
    """
    boxes, speeds = [], []
    for frame in range(frame_count):
        boxes.append(population.boxes(city))
        speeds.append(population.speeds())
        step_walkers(population, step_s, rng)
        step_drivers(population, boxes[-1], frame * step_s, step_s)
    return TrafficHistory(np.array(boxes), np.array(speeds), population.class_codes)


def step_walkers(population: Population, step_s: float, rng: np.random.Generator) -> None:
    """Pedestrians go on, wait at the kerb for traffic, and vary their pace."""
    walkers, drivers = population.walkers, population.drivers
    kerb = ~walkers.on_roadway(0.0) & walkers.on_roadway(1.5)
    offset = walkers.positions()[:, None] - drivers.rear[None]
    distance = np.linalg.norm(offset, axis=2)
    heading = np.stack([np.cos(drivers.yaw), np.sin(drivers.yaw)], axis=1)
    approaching = np.einsum("wdk,dk->wd", offset, heading * drivers.speed[:, None]) > 0.5
    unsafe = (distance < 12.0) | (approaching & (distance < 35.0))
    waits = kerb & unsafe.any(axis=1)
    walkers.pace += 0.1 * (1.0 - walkers.pace) + 0.05 * rng.standard_normal(len(walkers.pace))
    walkers.speed = np.where(waits, 0.0, walkers.desired * np.clip(walkers.pace, 0.3, 1.5))
    walkers.progress += walkers.speed * step_s


def step_drivers(population: Population, boxes: FloatArray, time_s: float, step_s: float) -> None:
    """Vehicles and cyclists look, brake or accelerate, steer and move.

    Args:
        population: who; changed.
        boxes: `(agents, 7)` of everybody now.
        time_s: since the start, for the signals.
        step_s: time step.
    """
    drivers = population.drivers
    seen = _look(population, boxes)
    wanted_aside = _wanted_offset(population, seen)
    free_speed = np.minimum(drivers.desired, _curve_speed(population))
    crowding = np.maximum(
        _crowding_by_others(population, seen), _crowding_by_signals(population, time_s)
    )
    acceleration = _ACCELERATION * (1 - (drivers.speed / free_speed) ** 4 - crowding)
    acceleration = np.clip(acceleration, -_HARDEST_BRAKING, None)
    drivers.speed = np.maximum(drivers.speed + acceleration * step_s, 0.0)
    sideways = np.minimum(1.2, 0.25 * drivers.speed) * step_s
    drivers.offset += np.clip(wanted_aside - drivers.offset, -sideways, sideways)
    _move(population, step_s)


def _look(population: Population, boxes: FloatArray) -> _Surroundings:
    drivers = population.drivers
    points, tangents = drivers.route_at(_WINDOW)
    centres = boxes[:, :2]
    nearest = _nearest(points, centres)
    rows = np.arange(len(points))[:, None]
    offset, tangent = centres[None] - points[rows, nearest], tangents[rows, nearest]
    past = (offset * tangent).sum(2)
    turned = boxes[None, :, 6] - np.arctan2(tangent[..., 1], tangent[..., 0])
    along, across = np.abs(np.cos(turned)), np.abs(np.sin(turned))
    length, width = boxes[None, :, 3], boxes[None, :, 4]
    near = np.abs(past) < 2.5
    near[np.arange(len(points)), np.arange(len(points))] = False
    return _Surroundings(
        ahead_m=_WINDOW[nearest] + past,
        aside_m=tangent[..., 0] * offset[..., 1] - tangent[..., 1] * offset[..., 0],
        half_length_m=0.5 * (length * along + width * across),
        half_width_m=0.5 * (length * across + width * along),
        speed_m_s=np.maximum(population.speeds()[None] * np.cos(turned), 0.0),
        near=near,
    )


def _nearest(points: FloatArray, centres: FloatArray) -> NDArray[np.int64]:
    """Which of a driver's points `(drivers, k, 2)` is nearest to each centre `(agents, 2)`."""
    middle = centres.mean(axis=0)
    here, there = (points - middle).astype(np.float32), (centres - middle).astype(np.float32)
    # |a - b|² without |b|², which is the same for all points; single precision is enough here.
    score = (here**2).sum(2)[:, :, None] - 2 * (here @ there.T)
    return np.asarray(score.argmin(axis=1))


def _in_way(population: Population, seen: _Surroundings, offset: FloatArray) -> NDArray[np.bool_]:
    """Agents that a driver holding `offset` `(drivers,)` from the route would meet."""
    reach = seen.half_width_m + population.drivers.width[:, None] / 2 + _MARGIN_M
    middle = population.drivers.length[:, None] / 2
    in_way: NDArray[np.bool_] = (
        seen.near & (np.abs(seen.aside_m - offset[:, None]) < reach) & (seen.ahead_m > middle)
    )
    return in_way


def _crowding_by_others(population: Population, seen: _Surroundings) -> FloatArray:
    drivers = population.drivers
    in_way = _in_way(population, seen, drivers.offset)
    gap = np.maximum(seen.ahead_m - seen.half_length_m - drivers.front_m[:, None], 0.1)
    crowding = _crowding(drivers.speed[:, None], seen.speed_m_s, gap)
    strongest: FloatArray = np.where(in_way, crowding, 0.0).max(axis=1)
    return strongest


def _crowding_by_signals(population: Population, time_s: float) -> FloatArray:
    drivers = population.drivers
    distance, signal = drivers.next_stop()
    order = (signal[:, 0] * 3 + signal[:, 1] * 5) % 4
    phase, into_phase = np.divmod(time_s + 2.7 * order, _PHASE_S)
    red = ((phase.astype(int) + order) % 4 != signal[:, 2]) | (into_phase > _GREEN_S)
    # Who could not stop without screeching drives on, as at yellow.
    can_stop = drivers.speed**2 < 2 * 4.0 * np.maximum(distance, 0.3)
    gap = np.maximum(distance + _STANDSTILL_GAP_M - 0.5, 0.1)
    crowding = _crowding(drivers.speed, np.zeros_like(distance), gap)
    stop: FloatArray = np.where(red & can_stop & (distance > -1.0), crowding, 0.0)
    return stop


def _crowding(speed: FloatArray, leader_speed: FloatArray, gap_m: FloatArray) -> FloatArray:
    """Interaction term of the Intelligent Driver Model."""
    closing = speed * (speed - leader_speed) / (2 * np.sqrt(_ACCELERATION * _BRAKING))
    wanted = _STANDSTILL_GAP_M + np.maximum(speed * _HEADWAY_S + closing, 0.0)
    crowding: FloatArray = (wanted / gap_m) ** 2
    return crowding


def _curve_speed(population: Population) -> FloatArray:
    """Speed from which each driver can slow down in time for the curves ahead."""
    ahead = np.arange(0, 40)
    limit = np.sqrt(_LATERAL_ACCELERATION / population.drivers.curvature_at(ahead))
    speed: FloatArray = np.sqrt(limit**2 + 2 * 1.5 * ahead).min(axis=1)
    return speed


def _wanted_offset(population: Population, seen: _Surroundings) -> FloatArray:
    """How far left of its route each driver wants to be: to pass who is slow or stands."""
    drivers = population.drivers
    slow = population.is_slow[None] & seen.near & (seen.speed_m_s < 0.6 * drivers.desired[:, None])
    reach = seen.half_width_m + drivers.width[:, None] / 2 + _MARGIN_M
    abreast = seen.half_length_m + 3.0
    obstacle = (
        slow
        & (np.abs(seen.aside_m) < reach)
        & (seen.ahead_m > -abreast)
        & (seen.ahead_m < 22.0 + drivers.front_m[:, None])
    )
    clearance = seen.aside_m + reach - _MARGIN_M + _PASSING_MARGIN_M
    wanted = np.where(obstacle, clearance, 0.0).max(axis=1)
    wanted[drivers.class_codes == CYCLIST] *= 0.5
    blocked = (_in_way(population, seen, wanted) & ~obstacle & (seen.ahead_m < _AHEAD_M)).any(
        axis=1
    )
    under_way = drivers.offset > 0.3
    held: FloatArray = np.where(blocked & ~under_way, 0.0, wanted)
    return held


def _move(population: Population, step_s: float) -> None:
    """Steer towards the route and follow the kinematic bicycle for one step."""
    drivers = population.drivers
    reach = np.maximum(3.5, 0.7 * drivers.speed + 1.5)
    target = drivers.point_ahead(reach)
    to_target = target - drivers.rear
    bearing = wrap_angle(np.arctan2(to_target[:, 1], to_target[:, 0]) - drivers.yaw)
    distance = np.maximum(np.linalg.norm(to_target, axis=1), 1.0)
    steering = np.arctan(2 * drivers.wheelbase * np.sin(bearing) / distance)
    steering = np.clip(steering, -_FULL_LOCK_RAD, _FULL_LOCK_RAD)
    turn = drivers.speed * np.tan(steering) / drivers.wheelbase * step_s
    middle = drivers.yaw + turn / 2
    heading = np.stack([np.cos(middle), np.sin(middle)], axis=1)
    drivers.rear += heading * (drivers.speed * step_s)[:, None]
    drivers.yaw = wrap_angle(drivers.yaw + turn)
    drivers.advance()
