"""The classical filter for few rows on a CPU: numpy, parameters worked out beforehand.

A lock step on a CPU has about a hundred rows, where a tensor operation is nearly all overhead. So
tracking on a CPU steps these classes instead of the torch modules they are made from, which remain
the definition, the training path and what other devices run (docs/adr/0004-packed-filters.md).

Everything is stored the other way round than in the modules: a row a column of the module's
matrix, a column a track, so that each quantity is contiguous. Methods change state in place.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray, wrap_angle
from hbbatch.motion import covariance as cov
from hbbatch.motion.columns import Columns, kalman_columns, kalman_order
from hbbatch.motion.constants import AXES, MAX_HEADING_VOTE, RANGE_UNIT_M, SMALLEST_SIZE_M
from hbbatch.motion.parameters import KalmanOptions, Parameters
from hbbatch.motion.turns import turn

Single = NDArray[np.float32]
IntArray = NDArray[np.int64]

DETECTION = Columns({"variance": AXES, "size_variance": 3, "range": 2, "ahead": 2})
"""What is known of a detection before it is matched: variances of its motion axes and its sizes;
its horizontal distance from the sensor in `RANGE_UNIT_M`, its height above it in m; the horizontal
direction it is seen in (world axes, of unit length beyond a metre)."""


class PackedFilter(Protocol):
    """A filter's steps on columns: boxes `(7, n)` float64, state `(height, n)` float32."""

    height: int

    def detections(self, sight_m: FloatArray, kinds: IntArray) -> Single:
        """Rows of `DETECTION` for detections seen along `sight_m` `(n, 3)`."""

    def birth(self, seen: Single, kinds: IntArray) -> Single:
        """State of tracks born from detections (columns of `detections`)."""

    def predict(self, boxes: FloatArray, state: Single, dt_s: Single) -> FloatArray:
        """Prior boxes `dt_s` `(n,)` seconds later; the state is changed in place."""

    def update(self, boxes: FloatArray, state: Single, measured: FloatArray, seen: Single) -> None:
        """Turn prior boxes and state into posterior ones, in place."""

    def velocity(self, state: Single) -> Single:
        """`(3, n)` velocity in the world frame, m/s."""


class PackedKalman:
    """`model.kalman.KalmanFilter`, packed.

    State: its columns, then constants of the track's kind.
    """

    def __init__(self, parameters: Parameters, options: KalmanOptions) -> None:
        """Parameters of the shapes that the options ask for."""
        self._motion = options.model
        self._columns = kalman_columns(options.model)
        self._pairs = cov.pairs(kalman_order(options.model))
        self._log_r = by_kind(parameters["log_r"])
        self._log_r_range = by_kind(parameters["log_r_range"])
        self._r_size = np.exp(by_kind(parameters["log_r_size"]))
        self._initial = np.exp(parameters["log_initial"]).transpose(1, 2, 0)
        self._constants = np.exp(
            np.concatenate([by_kind(parameters["log_q"]), by_kind(parameters["log_q_size"])])
        )
        width = self._columns.width
        self._noise = slice(width, width + AXES)
        self._size_noise = slice(self._noise.stop, self._noise.stop + 3)
        self.height = self._size_noise.stop

    def detections(self, sight_m: FloatArray, kinds: IntArray) -> Single:
        """See `PackedFilter.detections`."""
        seen = np.empty((DETECTION.width, len(kinds)), np.float32)
        x, y, up = sight_m.T.astype(np.float32)
        distance = np.maximum(np.sqrt(x * x + y * y), 1.0)
        far = distance / RANGE_UNIT_M
        seen[DETECTION["variance"]] = np.exp(
            self._log_r[:, kinds] + self._log_r_range[:, kinds] * far
        )
        seen[DETECTION["size_variance"]] = self._r_size[:, kinds]
        seen[DETECTION["range"]] = far, up
        seen[DETECTION["ahead"]] = x / distance, y / distance
        return seen

    def birth(self, seen: Single, kinds: IntArray) -> Single:
        """See `PackedFilter.birth`."""
        state = np.zeros((self.height, len(kinds)), np.float32)
        variances = [seen[DETECTION["variance"]], *self._initial[:, :, kinds]]
        for pair, block in self._covariance(state).items():
            if pair[0] == pair[1]:
                block[:] = variances[pair[0]]
        state[self._columns["size_variance"]] = seen[DETECTION["size_variance"]]
        state[self._columns["heading_vote"]] = 1.0
        state[self._columns["class_code"]] = kinds
        state[self._noise.start : self._size_noise.stop] = self._constants[:, kinds]
        return state

    def predict(self, boxes: FloatArray, state: Single, dt_s: Single) -> FloatArray:
        """See `PackedFilter.predict`."""
        return self.predict_with(boxes, state, dt_s, state[self._noise])

    def predict_with(
        self, boxes: FloatArray, state: Single, dt_s: Single, noise: Single
    ) -> FloatArray:
        """`predict` with the process noise `(4, n)` given."""
        step = self._advance(state, dt_s)
        covariance = self._covariance(state)
        for pair, block in cov.propagate(covariance, noise, dt_s).items():
            covariance[pair][:] = block
        state[self._columns["size_variance"]] += state[self._size_noise] * dt_s
        prior = boxes.copy()
        prior[:3] += step[:3]
        prior[6] += step[3]
        return prior

    def _advance(self, state: Single, dt_s: Single) -> Single:
        """World-frame step `(4, n)` by the motion model; the derivatives become those after it."""
        velocity = state[self._columns["velocity"]]
        if self._motion == "cv":
            return velocity * dt_s
        if self._motion == "ca":
            before = velocity.copy()
            velocity += state[self._columns["acceleration"]] * dt_s
            return (before + velocity) * (0.5 * dt_s)
        half = velocity[3] * (0.5 * dt_s)
        cos, sin = np.cos(half), np.sin(half)
        step = velocity.copy()
        step[0], step[1] = turn(velocity[0], velocity[1], cos, sin)
        velocity[0], velocity[1] = turn(step[0], step[1], cos, sin)
        step *= dt_s
        return step

    def update(self, boxes: FloatArray, state: Single, measured: FloatArray, seen: Single) -> None:
        """See `PackedFilter.update`."""
        new = PackedInnovation(boxes, measured)
        self.update_with(boxes, state, new, seen[DETECTION["variance"]], seen)

    def update_with(
        self,
        boxes: FloatArray,
        state: Single,
        new: PackedInnovation,
        variance: Single,
        seen: Single,
    ) -> None:
        """`update` with the innovation and the variance of measured motion `(4, n)` given."""
        covariance = self._covariance(state)
        gains, posterior = cov.correct(covariance, variance)
        for pair, block in posterior.items():
            covariance[pair][:] = block
        size_variance = state[self._columns["size_variance"]]
        size_gain = size_variance / (size_variance + seen[DETECTION["size_variance"]])
        size_variance *= 1.0 - size_gain
        move(boxes, gains[0] * new.motion, size_gain * new.size, new.cos, new.sin)
        _settle_heading(boxes, state[self._columns["heading_vote"]], new.flipped)
        for derivative, gain in enumerate(gains[1:]):
            change = gain * new.motion
            change[0], change[1] = turn(change[0], change[1], new.cos, new.sin)
            state[AXES * derivative : AXES * (derivative + 1)] += change

    def velocity(self, state: Single) -> Single:
        """See `PackedFilter.velocity`."""
        return state[self._columns["velocity"]][:3]

    def _covariance(self, state: Single) -> dict[tuple[int, int], Single]:
        """Views on the covariance blocks."""
        start = self._columns["covariance"].start
        return {
            pair: state[start + AXES * number : start + AXES * (number + 1)]
            for number, pair in enumerate(self._pairs)
        }


class PackedInnovation:
    """`model.filters.Innovation`, packed: measured boxes minus prior boxes, both `(7, n)`.

    Attributes:
        motion: `(4, n)` along, across, up, yaw; yaw as if a half turn did not matter.
        size: `(3, n)` length, width, height.
        flipped: `(n,)` bool, the measured heading points the other way.
        cos, sin: `(n,)` of the prior's yaw.
    """

    def __init__(self, prior: FloatArray, measured: FloatArray) -> None:
        """Compare."""
        difference = measured - prior
        local = difference.astype(np.float32)
        heading = prior[6].astype(np.float32)
        self.cos, self.sin = np.cos(heading), np.sin(heading)
        self.motion = np.empty((AXES, prior.shape[1]), np.float32)
        self.motion[0], self.motion[1] = turn(local[0], local[1], self.cos, -self.sin)
        self.motion[2] = local[2]
        self.motion[3] = wrap_half_turn(difference[6])
        self.size = local[3:6]
        self.flipped = np.cos(difference[6]) < 0.0


def move(boxes: FloatArray, motion: Single, size: Single, cos: Single, sin: Single) -> None:
    """`model.filters.moved`, in place: boxes `(7, n)` go by a heading-frame step."""
    x, y = turn(motion[0], motion[1], cos, sin)
    boxes[0] += x
    boxes[1] += y
    boxes[2] += motion[2]
    boxes[3:6] += size
    np.maximum(boxes[3:6], SMALLEST_SIZE_M, out=boxes[3:6])
    boxes[6] += motion[3]


def wrap_half_turn(angle_rad: NDArray[Any]) -> NDArray[Any]:
    """Angles wrapped to [-π/2, π/2)."""
    return (angle_rad + np.pi / 2) % np.pi - np.pi / 2


def _settle_heading(boxes: FloatArray, vote: Single, flipped: NDArray[np.bool_]) -> None:
    """`model.filters.settle_heading`, in place."""
    vote += 1.0 - 2.0 * flipped
    np.minimum(vote, MAX_HEADING_VOTE, out=vote)
    boxes[6] = wrap_angle(boxes[6] + np.pi * (vote[0] < 0.0))
    np.abs(vote, out=vote)


def by_kind(parameter: Single) -> Single:
    """A parameter `(kinds, k)` as `(k, kinds)`, to be indexed by kind."""
    return np.ascontiguousarray(parameter.T)
