"""A 3D detector with the faults of real ones: misses, noise, flipped headings, false boxes.

What goes wrong with an object goes wrong for a while: every error is the sum of a part that is new
in every frame and two first-order autoregressive processes in time, a fast and a slow one. Its
marginal distribution does not depend on the correlation, nor the correlation on the frame rate.
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

# Columns of the error processes of an object; misses, flips and the spread last.
_ALONG, _ACROSS, _UP, _DLENGTH, _DWIDTH, _DHEIGHT, _DYAW, _SCORE, _FLIP, _MISS, _SPREAD = range(11)
_ERRORS: Final = 11
_LASTING_FROM: Final = _FLIP

_NOISE_OF_CLASS: Final = {
    CAR: (1.9, 1.0, 0.8, 1.0, 1.0),
    PEDESTRIAN: (1.5, 1.5, 1.6, 8.0, 2.5),
    CYCLIST: (1.5, 1.1, 1.0, 4.0, 1.3),
    TRUCK: (2.5, 1.3, 1.2, 1.0, 1.2),
}
"""Noise along, across, up, of yaw and of sizes, in units of what the settings say of cars."""

_FACE_SHIFT: Final = 0.25
"""Share of an error of the length that moves the centre: the near face is measured best."""

_LARGEST_LOG_SIZE: Final = 0.5
"""Bound on the logarithm of a size's error: detectors keep to sizes their training showed them."""

_HIDDEN_GROWTH: Final = 1.5
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
    """A detector at work; remembers its errors from frame to frame.

    Attributes:
        settings: how good it is.
        sensor: what it works on.
        class_codes: `(objects,)` of the true objects.
        step_s: time between frames.
        rng: source of chance.
    """

    settings: DetectorSettings
    sensor: SensorSettings
    class_codes: IntArray
    step_s: float
    rng: np.random.Generator
    _drifting: FloatArray = field(init=False)
    _lasting: FloatArray = field(init=False)
    _errors: FloatArray = field(init=False)
    _size_bias: FloatArray = field(init=False)
    _class_noise: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        shape = len(self.class_codes), _ERRORS
        self._drifting = self.rng.standard_normal(shape)
        self._lasting = self.rng.standard_normal(shape)
        self._size_bias = self.rng.standard_normal((shape[0], 3))
        by_code = np.array([_NOISE_OF_CLASS[code] for code in range(len(_NOISE_OF_CLASS))])
        self._class_noise = by_code[self.class_codes]

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
        settings = self.settings
        self._drifting = self._after_a_step(self._drifting, settings.drift_s)
        self._lasting = self._after_a_step(self._lasting, settings.lasting_s)
        drifting_share = 1.0 - settings.new_share - settings.lasting_share
        self._errors = (
            np.sqrt(settings.new_share) * self.rng.standard_normal(self._lasting.shape)
            + np.sqrt(drifting_share) * self._drifting
            + np.sqrt(settings.lasting_share) * self._lasting
        )
        self._errors[:, _LASTING_FROM:] = self._lasting[:, _LASTING_FROM:]

    def _after_a_step(self, process: FloatArray, memory_s: float) -> FloatArray:
        """A process of variance 1 a frame later."""
        keep = np.exp(-self.step_s / memory_s)
        fresh = self.rng.standard_normal(process.shape)
        stepped: FloatArray = keep * process + np.sqrt(1 - keep**2) * fresh
        return stepped

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
        luck = 0.8 * self._errors[:, _SCORE] - 0.4 * self._errors[:, _SPREAD]
        quality = 3.0 * recall + luck - 1.0
        scores = 1 / (1 + np.exp(-quality[found]))
        return Detections(boxes, scores, self.class_codes[found], found)

    def _noisy(self, seen: View) -> FloatArray:
        settings, error = self.settings, self._errors
        boxes = seen.boxes.copy()
        along, across, up, turned, sized = (self._noise(seen) * self._class_noise).T
        # Half of the variance of sizes is constant for an object.
        relative = np.sqrt(0.5) * (error[:, _DLENGTH : _DHEIGHT + 1] + self._size_bias)
        sizes = settings.size_noise * sized[:, None] * relative
        boxes[:, LENGTH : HEIGHT + 1] *= np.exp(
            np.clip(sizes, -_LARGEST_LOG_SIZE, _LARGEST_LOG_SIZE)
        )
        longer = boxes[:, LENGTH] - seen.boxes[:, LENGTH]
        cos, sin = np.cos(boxes[:, YAW]), np.sin(boxes[:, YAW])
        away = np.sign(boxes[:, 0] * cos + boxes[:, 1] * sin)
        forward = settings.position_noise_m * along * error[:, _ALONG] + _FACE_SHIFT * away * longer
        left = settings.position_noise_m * across * error[:, _ACROSS]
        boxes[:, 0] += cos * forward - sin * left
        boxes[:, 1] += sin * forward + cos * left
        boxes[:, 2] += settings.position_noise_m * up * error[:, _UP]
        boxes[:, YAW] += settings.yaw_noise_rad * turned * error[:, _DYAW]
        boxes[ndtr(error[:, _FLIP]) < settings.flip_share, YAW] += np.pi
        boxes[:, YAW] = wrap_angle(boxes[:, YAW])
        return boxes

    def _noise(self, seen: View) -> FloatArray:
        """How much larger than at range 0 and in full view errors are, `(objects, 1)`."""
        growth = 1.0 + (seen.range_m / self.settings.noise_doubling_m) ** 2
        growth *= 1.0 + _HIDDEN_GROWTH * (1.0 - seen.visible)
        growth *= np.exp(self.settings.spread * self._errors[:, _SPREAD])
        return growth[:, None]

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
