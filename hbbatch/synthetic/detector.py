"""A 3D detector with the faults of real ones: misses, noise, flipped headings, false boxes.

What goes wrong with an object goes wrong for a while: every error is a first-order autoregressive
process in time, one an object. Its marginal distribution does not depend on the correlation.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from hbbatch.boxes import HEIGHT, LENGTH, YAW, FloatArray, wrap_angle
from hbbatch.synthetic.sensor import View
from hbbatch.synthetic.settings import (
    CAR,
    CYCLIST,
    PEDESTRIAN,
    TRUCK,
    DetectorSettings,
    SensorSettings,
)

IntArray = NDArray[np.int64]

# Columns of the error processes of an object.
_DX, _DY, _DZ, _DLENGTH, _DWIDTH, _DHEIGHT, _DYAW, _FLIP, _MISS, _SCORE = range(10)
_ERRORS: Final = 10
_RANGE_DOUBLING_YAW_M: Final = 50.0
_CLUTTER_SIZES_M: Final = {
    CAR: (3.9, 1.7, 1.5),
    PEDESTRIAN: (0.7, 0.6, 1.7),
    CYCLIST: (1.7, 0.6, 1.7),
    TRUCK: (8.0, 2.4, 3.0),
}
_FALSE_CLASS_SHARES: Final = (0.55, 0.05, 0.1, 0.3)


@dataclass(frozen=True)
class Detections:
    """Boxes that the detector said in one frame.

    Attributes:
        boxes: `(n, 7)` sensor frame.
        scores: `(n,)` in 0..1.
        class_codes: `(n,)` index into `settings.CLASS_NAMES`.
        object_id: `(n,)` the true object, -1 for a false box.
    """

    boxes: FloatArray
    scores: FloatArray
    class_codes: IntArray
    object_id: IntArray


@dataclass
class Detector:
    """A detector at work; remembers its errors from frame to frame."""

    settings: DetectorSettings
    sensor: SensorSettings
    class_codes: IntArray
    rng: np.random.Generator
    _errors: FloatArray = field(init=False)
    _size_bias: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        count = len(self.class_codes)
        self._errors = self.rng.standard_normal((count, _ERRORS))
        self._size_bias = self.rng.standard_normal((count, 3))

    def detect(self, seen: View, false_places: View, false_codes: IntArray) -> Detections:
        """The boxes of one frame.

        Args:
            seen: true objects, in the order of `class_codes`.
            false_places: places that may be mistaken for an object.
            false_codes: what for.
        """
        self._step()
        parts = [
            self._true_boxes(seen),
            self._duplicates(seen),
            self._clutter(false_places, false_codes),
            self._transients(),
        ]
        columns = zip(*(vars(part).values() for part in parts), strict=True)
        return Detections(*(np.concatenate(column) for column in columns))

    def _step(self) -> None:
        keep = np.full(_ERRORS, self.settings.noise_correlation)
        keep[[_MISS, _FLIP]] = self.settings.miss_correlation
        fresh = self.rng.standard_normal(self._errors.shape)
        self._errors = keep * self._errors + np.sqrt(1 - keep**2) * fresh

    def _recall(self, seen: View) -> FloatArray:
        """Chance that each object is found."""
        surplus = np.log(np.maximum(seen.points, 1e-3) / self.settings.points_for_half)
        chance: FloatArray = self.settings.max_recall / (1 + np.exp(-2.0 * surplus))
        return np.where(seen.visible > 0, chance, 0.0)

    def _true_boxes(self, seen: View) -> Detections:
        recall = self._recall(seen)
        found = np.flatnonzero(ndtr(self._errors[:, _MISS]) < recall)
        boxes = self._noisy(seen)[found]
        # What is easy to find is scored high; the rest of the score is luck.
        quality = 3.0 * recall + 0.9 * self._errors[:, _SCORE] - 1.0
        scores = 1 / (1 + np.exp(-quality[found]))
        return Detections(boxes, scores, self.class_codes[found], found)

    def _noisy(self, seen: View) -> FloatArray:
        settings, error = self.settings, self._errors
        boxes = seen.boxes.copy()
        hidden = 1.0 + 1.5 * (1.0 - seen.visible)
        sigma = settings.position_noise_m + settings.position_noise_per_m * seen.range_m
        small = np.minimum(1.0, 0.5 + boxes[:, LENGTH] / 8.0)
        sigma = sigma * hidden * small
        boxes[:, :2] += error[:, _DX : _DY + 1] * sigma[:, None]
        boxes[:, 2] += error[:, _DZ] * 0.5 * sigma
        relative = 0.7071 * (error[:, _DLENGTH : _DHEIGHT + 1] + self._size_bias)
        factor = np.exp(settings.size_noise * np.sqrt(hidden)[:, None] * relative)
        boxes[:, LENGTH : HEIGHT + 1] *= factor
        growth = 1.0 + seen.range_m / _RANGE_DOUBLING_YAW_M
        boxes[:, YAW] += error[:, _DYAW] * settings.yaw_noise_rad * growth * np.sqrt(hidden)
        boxes[ndtr(error[:, _FLIP]) < settings.flip_share, YAW] += np.pi
        boxes[:, YAW] = wrap_angle(boxes[:, YAW])
        return boxes

    def _duplicates(self, seen: View) -> Detections:
        """Second boxes on objects that are there."""
        chance = self.settings.duplicate_share * (self._recall(seen) > 0.3)
        twice = np.flatnonzero(self.rng.random(len(chance)) < chance)
        boxes = seen.boxes[twice]
        boxes[:, :2] += self.rng.normal(0, 0.8, (len(twice), 2))
        scores = self.rng.uniform(0.1, 0.45, len(twice))
        return Detections(boxes, scores, self.class_codes[twice], np.full(len(twice), -1))

    def _clutter(self, places: View, codes: IntArray) -> Detections:
        """False boxes at places that look like something, again and again."""
        looks = (places.visible > 0.3) & (places.range_m > 3.0)
        said = np.flatnonzero(looks & (self.rng.random(len(codes)) < self.settings.clutter_share))
        boxes = places.boxes[said]
        boxes[:, :2] += self.rng.normal(0, 0.2, (len(said), 2))
        boxes[:, YAW] = wrap_angle(boxes[:, YAW] + self.rng.normal(0, 0.3, len(said)))
        scores = self.rng.beta(2.0, 5.0, len(said))
        return Detections(boxes, scores, codes[said], np.full(len(said), -1))

    def _transients(self) -> Detections:
        """False boxes that nothing explains."""
        count = int(self.rng.poisson(self.settings.transient_per_frame))
        codes = self.rng.choice(len(_FALSE_CLASS_SHARES), count, p=_FALSE_CLASS_SHARES)
        half = self.sensor.field_of_view_rad / 2
        range_m = self.rng.uniform(5.0, self.sensor.range_m, count)
        azimuth = self.rng.uniform(-half, half, count)
        boxes = np.zeros((count, 7))
        boxes[:, 0], boxes[:, 1] = range_m * np.cos(azimuth), range_m * np.sin(azimuth)
        boxes[:, LENGTH : HEIGHT + 1] = clutter_sizes(codes)
        boxes[:, 2] = boxes[:, HEIGHT] / 2 - self.sensor.height_m
        boxes[:, YAW] = self.rng.uniform(-np.pi, np.pi, count)
        scores = self.rng.beta(1.5, 6.0, count)
        return Detections(boxes, scores, codes, np.full(count, -1))


def clutter_sizes(codes: IntArray) -> FloatArray:
    """Length, width and height `(n, 3)` of false boxes."""
    sizes = np.array([_CLUTTER_SIZES_M[code] for code in range(len(_CLUTTER_SIZES_M))])
    return sizes[codes]


def false_classes(count: int, rng: np.random.Generator) -> IntArray:
    """What false boxes are taken for, `(count,)`."""
    codes: IntArray = rng.choice(len(_FALSE_CLASS_SHARES), count, p=_FALSE_CLASS_SHARES)
    return codes
