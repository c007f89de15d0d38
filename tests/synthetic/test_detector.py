"""The detector's faults have the size, the growth and the persistence they are set to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hbbatch.boxes import wrap_angle
from hbbatch.synthetic.detector import Detections, Detector
from hbbatch.synthetic.sensor import View
from hbbatch.synthetic.settings import CAR, DetectorSettings, SensorSettings

NO_PLACES = View(np.zeros((0, 7)), np.zeros(0), np.zeros(0), np.zeros(0))
NO_CODES = np.zeros(0, dtype=np.int64)
ONLY_TRUE = DetectorSettings(transient_per_frame=0.0, duplicate_share=0.0)
FRAMES = 300


def cars(range_m: float, count: int, visible: float = 1.0, points: float = 1e4) -> View:
    boxes = np.tile([range_m, 0.0, -1.0, 4.4, 1.8, 1.5, 0.0], (count, 1))
    return View(boxes, *(np.full(count, value) for value in (range_m, visible, points)))


def run(
    view: View, settings: DetectorSettings, frames: int = FRAMES, step_s: float = 0.1
) -> list[Detections]:
    codes = np.full(len(view.boxes), CAR)
    detector = Detector(settings, SensorSettings(), codes, step_s, np.random.default_rng(0))
    return [detector.detect(view, NO_PLACES, NO_CODES) for _ in range(frames)]


def errors(view: View, settings: DetectorSettings = ONLY_TRUE) -> np.ndarray:
    """Errors of all boxes said, `(n, 7)`."""
    said = run(view, settings)
    return np.concatenate([d.boxes - view.boxes[d.object_id] for d in said])


def test_noise_has_the_size_it_is_set_to_and_doubles_with_range() -> None:
    even = replace(ONLY_TRUE, spread=0.0)
    near, far = errors(cars(1.0, 60), even), errors(cars(38.0, 60), even)
    assert near[:, 1].std() == pytest.approx(0.035, rel=0.1)
    assert far[:, 1].std() == pytest.approx(2 * 0.035, rel=0.1)
    assert near[:, 0].std() > 1.5 * near[:, 1].std(), "lengths, and so centres, are hard to see"


def test_noise_along_the_heading_turns_with_the_object() -> None:
    across_the_view = cars(20.0, 60)
    across_the_view.boxes[:, 6] = np.pi / 2
    error = errors(across_the_view)
    assert error[:, 1].std() > 1.5 * error[:, 0].std()


def test_a_box_that_is_too_long_reaches_too_far_back() -> None:
    only_size = replace(ONLY_TRUE, position_noise_m=0.0, size_noise=0.05)
    error = errors(cars(20.0, 40), only_size)
    assert error[:, 0] == pytest.approx(0.25 * error[:, 3])


def test_hidden_objects_are_measured_worse() -> None:
    seen, hidden = errors(cars(30.0, 40)), errors(cars(30.0, 40, visible=0.3))
    assert hidden[:, :2].std() > 1.7 * seen[:, :2].std()


def test_no_box_is_of_another_order_of_size_than_its_object() -> None:
    rough = replace(ONLY_TRUE, size_noise=2.0)
    view = cars(60.0, 4000, visible=0.2)
    sizes = np.concatenate([said.boxes[:, 3:6] for said in run(view, rough)])
    ratio = sizes / view.boxes[0, 3:6]
    assert 0.6 < ratio.min() < ratio.max() < 1.66


@pytest.mark.parametrize("step_s", [0.05, 0.1, 0.2])
def test_errors_last_for_a_while_whatever_the_frame_rate(step_s: float) -> None:
    settings = replace(ONLY_TRUE, max_recall=1.0, spread=0.0)
    said = run(cars(20.0, 100), settings, step_s=step_s)
    offset = np.array([d.boxes[:, 1] for d in said])

    def correlation(lag: int) -> float:
        return float(np.corrcoef(offset[:-lag].ravel(), offset[lag:].ravel())[0, 1])

    for lag in (1, 4, 10):
        drifting = 0.35 * np.exp(-lag * step_s / settings.drift_s)
        lasting = 0.35 * np.exp(-lag * step_s / settings.lasting_s)
        assert correlation(lag) == pytest.approx(drifting + lasting, abs=0.06)


def test_misses_come_in_bursts() -> None:
    often_missed = replace(ONLY_TRUE, max_recall=0.85)
    found = np.zeros((FRAMES, 80), bool)
    for frame, said in enumerate(run(cars(20.0, 80), often_missed)):
        found[frame, said.object_id] = True
    assert found.mean() == pytest.approx(0.85, abs=0.04)
    missed_again = (~found[1:] & ~found[:-1]).sum() / (~found[:-1]).sum()
    assert 0.7 < missed_again < 0.95


def test_some_headings_point_backwards() -> None:
    yaw = wrap_angle(errors(cars(20.0, 60), replace(ONLY_TRUE, flip_share=0.05))[:, 6])
    assert (np.abs(yaw) > np.pi / 2).mean() == pytest.approx(0.05, abs=0.015)


def test_recall_falls_with_the_points_on_an_object() -> None:
    def recall(points: float) -> float:
        said = run(cars(30.0, 50, points=points), ONLY_TRUE)
        return float(np.mean([len(d.scores) for d in said])) / 50

    assert recall(1e4) == pytest.approx(ONLY_TRUE.max_recall, abs=0.02)
    half = ONLY_TRUE.max_recall / 2
    assert recall(ONLY_TRUE.points_for_half) == pytest.approx(half, abs=0.05)
    assert recall(1.0) < 0.02


def test_what_cannot_be_seen_is_not_found() -> None:
    assert all(len(d.scores) == 0 for d in run(cars(30.0, 20, visible=0.0, points=0.0), ONLY_TRUE))


def test_scores_tell_easy_objects_from_hard_ones_and_from_false_boxes() -> None:
    settings = DetectorSettings(transient_per_frame=3.0)
    easy, hard = run(cars(10.0, 30), settings), run(cars(60.0, 30, points=12.0), settings)

    def mean_score(said: list[Detections], true: bool) -> float:
        return float(np.concatenate([d.scores[(d.object_id >= 0) == true] for d in said]).mean())

    assert mean_score(easy, True) > mean_score(hard, True) + 0.2
    assert mean_score(hard, True) > mean_score(hard, False) + 0.1


def test_false_boxes_come_at_the_set_rate_and_clutter_stays_where_it_is() -> None:
    settings = DetectorSettings(transient_per_frame=2.0, clutter_share=0.25)
    places, codes = cars(25.0, 4), np.full(4, CAR)
    detector = Detector(settings, SensorSettings(), NO_CODES, 0.1, np.random.default_rng(1))
    said = [detector.detect(NO_PLACES, places, codes) for _ in range(FRAMES)]
    count = np.mean([len(d.scores) for d in said])
    assert count == pytest.approx(2.0 + 4 * 0.25, rel=0.1)
    boxes = np.concatenate([d.boxes for d in said])
    at_place = np.hypot(boxes[:, 0] - 25.0, boxes[:, 1]) < 1.0
    assert at_place.sum() / FRAMES == pytest.approx(1.0, rel=0.15)
    assert all((d.object_id == -1).all() for d in said)
