"""The classical filter for few rows on a CPU: numpy, parameters worked out beforehand.

A lock step on a CPU has about a hundred rows, where a tensor operation is nearly all overhead. So
tracking on a CPU steps these classes instead of the torch modules they are made from, which remain
the definition, the training path and what other devices run (docs/adr/0004-packed-filters.md).

Everything is stored the other way round than in the modules: a row a column of the module's
matrix, a column a track, so that each quantity is contiguous. Methods change state in place, and
rows are ordered such that one operation serves several quantities.
"""

from __future__ import annotations

from typing import Final, NamedTuple, Protocol

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.motion.columns import Columns, MotionModel, kalman_order
from hbbatch.motion.constants import AXES, MAX_HEADING_VOTE, RANGE_UNIT_M
from hbbatch.motion.covariance import pairs
from hbbatch.motion.parameters import KalmanOptions, Parameters
from hbbatch.packed.arrays import (
    MOTION,
    PLAN,
    YAW_ROW,
    Heading,
    IntArray,
    Single,
    difference,
    keep_sizes,
)
from hbbatch.packed.covariance import PackedCovariance

DETECTION: Final = Columns({"size_variance": 3, "variance": AXES, "range": 2, "ahead": 2})
"""What is known of a detection before it is matched: variances of its sizes and its motion axes;
its horizontal distance from the sensor in `RANGE_UNIT_M`, its height above it in m; the horizontal
direction it is seen in (world axes, of unit length beyond a metre)."""

BOX_VARIANCE: Final = slice(0, 7)
"""Rows of `DETECTION`: variances in the order of a packed box."""


class Times(NamedTuple):
    """Rows of the arrays that filters make of time steps before the first one is taken."""

    dt_s: int = 0
    half_s: int = 1
    tenths: int = 2
    inverse: int = 3
    weights: int = 4


TIMES: Final = Times()


class PackedFilter(Protocol):
    """A filter's steps on columns: packed boxes `(7, n)` float64, state `(height, n)` float32."""

    height: int

    def times(self, dt_s: Single) -> Single:
        """What `predict` needs to know of time steps `(n,)`; a column each."""

    def detections(self, sight_m: FloatArray, kinds: IntArray) -> Single:
        """Rows of `DETECTION` for detections seen along `sight_m` `(n, 3)`."""

    def birth(self, boxes: FloatArray, seen: Single, kinds: IntArray) -> Single:
        """State of tracks born from detections: their boxes and columns of `detections`."""

    def predict(self, boxes: FloatArray, state: Single, times: Single) -> FloatArray:
        """Prior boxes after time steps (columns of `times`); the state is changed in place."""

    def update(self, boxes: FloatArray, state: Single, measured: FloatArray, seen: Single) -> None:
        """Turn prior boxes and state into posterior ones, in place."""

    def velocity(self, state: Single) -> Single:
        """`(3, n)` velocity in the world frame, m/s."""


def kalman_rows(model: MotionModel) -> dict[str, int]:
    """State of the classical filter. Size variances lie before those of the axes' positions."""
    order = kalman_order(model)
    return {
        "velocity": AXES,
        "acceleration": AXES * (order - 2),
        "size_variance": 3,
        "covariance": AXES * len(pairs(order)),
        "heading_vote": 1,
        "noise": AXES,
        "size_noise": 3,
    }


class PackedKalman:
    """`model.kalman.KalmanFilter`, packed."""

    def __init__(
        self, parameters: Parameters, options: KalmanOptions, rows: Columns | None = None
    ) -> None:
        """Parameters of the shapes that the options ask for.

        Args:
            parameters: arrays by name.
            options: of the filter.
            rows: of a larger state that holds those of `kalman_rows`.
        """
        self._model = options.model
        self._rows = rows or Columns(kalman_rows(options.model))
        self._covariance = PackedCovariance(kalman_order(options.model))
        start = self._rows["size_variance"].start
        self._box_variance = slice(start, start + 7)
        self._log_r = by_kind(parameters["log_r"])
        self._log_r_range = by_kind(parameters["log_r_range"])
        self._r_size = np.exp(by_kind(parameters["log_r_size"]))
        self.height = self._rows.width
        self.newborn = self._newborn(parameters)
        self._derivatives = kalman_order(options.model) - 1

    def _newborn(self, parameters: Parameters) -> Single:
        """State of a track of each kind before its detection is looked at, `(height, kinds)`."""
        rows = self._rows
        state = np.zeros((self.height, len(parameters["log_q"])), np.float32)
        variances = np.exp(parameters["log_initial"]).transpose(1, 2, 0)
        self._covariance.start(state[rows["covariance"]], variances)
        state[rows["heading_vote"]] = 1.0
        state[rows["noise"]] = np.exp(by_kind(parameters["log_q"]))
        state[rows["size_noise"]] = np.exp(by_kind(parameters["log_q_size"]))
        return state

    def times(self, dt_s: Single) -> Single:
        """See `PackedFilter.times`; rows of `Times`, then the weights of covariances."""
        rows = np.stack([dt_s, 0.5 * dt_s, 10.0 * dt_s, 1.0 / dt_s])
        return np.concatenate([rows, self._covariance.weights(dt_s)])

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

    def birth(
        self,
        boxes: FloatArray,  # noqa: ARG002 - the learned filter looks at them
        seen: Single,
        kinds: IntArray,
    ) -> Single:
        """See `PackedFilter.birth`."""
        state = self.newborn.take(kinds, axis=1)
        state[self._box_variance] = seen[BOX_VARIANCE]
        return state

    def predict(self, boxes: FloatArray, state: Single, times: Single) -> FloatArray:
        """See `PackedFilter.predict`."""
        prior = boxes.copy()
        prior[MOTION] += self.advance(state, times) * times[TIMES.dt_s]
        return prior

    def advance(self, state: Single, times: Single) -> Single:
        """Take the state on by a time step; the mean velocity of the axes `(4, n)` meanwhile."""
        rows = self._rows
        self._covariance.propagate(
            state[rows["covariance"]], state[rows["noise"]], times[TIMES.weights :]
        )
        state[rows["size_variance"]] += state[rows["size_noise"]] * times[TIMES.dt_s]
        velocity = state[rows["velocity"]]
        mean = velocity.copy()
        if self._model == "ca":
            half = state[rows["acceleration"]] * times[TIMES.half_s]
            mean += half
            np.add(mean, half, out=velocity)
        elif self._model == "ct":
            # The chord of a turn points along the heading in the middle of it.
            half_turn = Heading.of(velocity[3] * times[TIMES.half_s])
            half_turn.turn(mean[:2])
            velocity[:2] = mean[:2]
            half_turn.turn(velocity[:2])
        return mean

    def update(self, boxes: FloatArray, state: Single, measured: FloatArray, seen: Single) -> None:
        """See `PackedFilter.update`."""
        heading = Heading.of(boxes[YAW_ROW])
        apart, agreement = difference(measured, boxes)
        innovation = apart.astype(np.float32)
        heading.turn_back(innovation[PLAN])
        change = self.correct(boxes, state, innovation, seen[BOX_VARIANCE])
        self.apply(boxes, state, change, heading)
        self.settle_heading(boxes, state, agreement)

    def correct(
        self, boxes: FloatArray, state: Single, innovation: Single, variance: Single
    ) -> Single:
        """Gains times innovation, and posterior covariances.

        Args:
            boxes: prior ones, left as they are.
            state: changed in place.
            innovation: `(7, n)` of a packed box, in the heading frame.
            variance: `(7, n)` of the measurement.

        Returns:
            Changes of the packed box, then of each derivative of its axes, in the heading frame.
        """
        spread = state[self._box_variance]
        inverse = np.reciprocal(spread + variance)
        gain = spread * inverse
        change = np.empty((7 + AXES * self._derivatives, innovation.shape[1]), np.float32)
        np.multiply(gain, innovation, out=change[:7])
        covariance = state[self._rows["covariance"]]
        higher = self._covariance.shrink(covariance, gain[MOTION], inverse[MOTION])
        for number, derivative_gain in enumerate(higher):
            start = 7 + AXES * number
            np.multiply(derivative_gain, innovation[MOTION], out=change[start : start + AXES])
        spread -= gain * spread
        keep_sizes(boxes, change, 1.0)
        return change

    def apply(self, boxes: FloatArray, state: Single, change: Single, heading: Heading) -> None:
        """Turn the changes that `correct` returned to the world's axes, and make them."""
        axes = change[MOTION.start :].reshape(1 + self._derivatives, AXES, change.shape[1])
        heading.turn(axes[:, :2])
        boxes += change[:7]
        state[self._rows["velocity"]] += axes[1]
        if self._model == "ca":
            state[self._rows["acceleration"]] += axes[2]

    def settle_heading(self, boxes: FloatArray, state: Single, agreement: FloatArray) -> None:
        """`model.filters.settle_heading`, in place; agreement from `arrays.difference`."""
        vote, yaw = state[self._rows["heading_vote"]][0], boxes[YAW_ROW]
        vote += np.copysign(1.0, agreement)
        np.minimum(vote, MAX_HEADING_VOTE, out=vote)
        # By no turn or, where the vote is lost, a half turn; then wrapped to [-π, π).
        yaw -= np.copysign(0.5 * np.pi, vote, dtype=np.float64)
        yaw += 1.5 * np.pi
        yaw %= 2.0 * np.pi
        yaw -= np.pi
        np.abs(vote, out=vote)

    def velocity(self, state: Single) -> Single:
        """See `PackedFilter.velocity`."""
        return state[self._rows["velocity"]][:3]


def by_kind(parameter: Single) -> Single:
    """A parameter `(kinds, k)` as `(k, kinds)`, to be indexed by kind."""
    return np.ascontiguousarray(parameter.T)
