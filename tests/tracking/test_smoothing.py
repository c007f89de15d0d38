"""Boxes settled by what came before and after them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hbbatch.tracking.frames import SequenceFrames
from hbbatch.tracking.smoothing import settle_sizes, smoothed
from hbbatch.tracking.tracks import SequenceTracks, TrackState
from tests.tracking.drives import sequence
from tests.tracking.test_refine import box, tracks, where_found

REACH_S = 1.5
FRAMES = 60

Path = Callable[[np.ndarray], np.ndarray]
"""Boxes `(n, 7)` by time."""


def standing(time_s: np.ndarray) -> np.ndarray:
    return np.tile([30.0, 5.0, 0.8, 4.0, 1.8, 1.5, 0.4], (len(time_s), 1))


def turning(time_s: np.ndarray) -> np.ndarray:
    """Round a corner: 8 m/s on a circle of 20 m."""
    yaw = 0.4 * time_s
    boxes = standing(time_s)
    boxes[:, 0], boxes[:, 1], boxes[:, 6] = 20 * np.sin(yaw), 25 - 20 * np.cos(yaw), yaw
    return boxes


def detected(boxes: np.ndarray) -> tuple[SequenceTracks, SequenceFrames]:
    """One track of boxes that were detected frame by frame."""
    given = tracks([(f, 1, 1.0, list(b)) for f, b in enumerate(boxes)])
    return given, where_found(given, len(boxes))


def noisy(boxes: np.ndarray, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    noise = rng.normal(0, [0.1, 0.1, 0.05, 0, 0, 0, 0.05], boxes.shape)
    return np.asarray(boxes + noise)


def mean_error(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Of centres (m) and of headings (rad)."""
    turn = np.abs((found[:, 6] - truth[:, 6] + np.pi) % (2 * np.pi) - np.pi)
    return float(np.linalg.norm((found - truth)[:, :3], axis=1).mean()), float(turn.mean())


@pytest.mark.parametrize("path", [standing, turning])
def test_noise_averages_away(path: Path) -> None:
    truth = path(np.arange(FRAMES) * 0.1)
    given, frames = detected(noisy(truth))
    found = smoothed(given, frames, REACH_S)
    for before, after in zip(
        mean_error(given.boxes, truth), mean_error(found.boxes, truth), strict=True
    ):
        assert after < 0.6 * before


@pytest.mark.parametrize("path", [standing, turning])
@pytest.mark.parametrize("east_m", [0.0, 5e6])
def test_even_motion_is_kept_wherever_it_is(path: Path, east_m: float) -> None:
    truth = path(np.arange(FRAMES) * 0.1)
    truth[:, 0] += east_m
    given, frames = detected(truth)
    frames = replace(frames, translation_m=frames.translation_m + np.array([east_m, 0, 0]))
    off_m, off_rad = mean_error(smoothed(given, frames, REACH_S).boxes, truth)
    assert off_m < 0.02, "a few centimetres where a corner begins and ends"
    assert off_rad < 0.005


def test_an_outlier_hardly_counts() -> None:
    truth = standing(np.arange(FRAMES) * 0.1)
    boxes = noisy(truth)
    boxes[30, 0] += 3.0
    found = smoothed(*detected(boxes), REACH_S)
    assert abs(found.boxes[30, 0] - truth[30, 0]) < 0.2


def test_which_way_a_box_faces_is_the_filters_to_say() -> None:
    """The detector turns every other box round; the filter does not follow."""
    truth = standing(np.arange(FRAMES) * 0.1)
    given, frames = detected(truth)
    turned = frames.boxes.copy()
    turned[::2, 6] += np.pi
    found = smoothed(given, replace(frames, boxes=turned), REACH_S)
    assert found.boxes[:, 6] == pytest.approx(truth[:, 6], abs=1e-6)


def test_errors_of_the_ego_pose_cancel_in_the_sensor_frame() -> None:
    """The sensor stands still, and so does the object; the pose says that the ego sways."""
    still = standing(np.arange(FRAMES) * 0.1)
    sway = np.zeros((FRAMES, 3))
    sway[:, 2] = 0.1 * (-1.0) ** np.arange(FRAMES)
    swayed = still.copy()
    swayed[:, :3] += sway
    given, frames = detected(swayed)
    frames = replace(frames, translation_m=sway)
    found = smoothed(given, frames, REACH_S).boxes[:, 2] - sway[:, 2]
    assert np.abs(found - 0.8).max() < 0.1
    assert np.abs(found - 0.8)[5:-5].mean() < 0.05


def test_what_was_interpolated_follows_what_was_detected() -> None:
    truth = turning(np.arange(FRAMES) * 0.1)
    given, frames = detected(truth)
    gap = (given.frame_index > 25) & (given.frame_index < 34)
    straight = given.boxes.copy()
    share = (given.frame_index[gap] - 25) / 9
    straight[gap, :2] = np.outer(1 - share, truth[25, :2]) + np.outer(share, truth[34, :2])
    given = replace(
        given,
        boxes=straight,
        detection_row=np.where(gap, -1, given.detection_row),
        state=np.where(gap, TrackState.INTERPOLATED, given.state),
    )
    found = smoothed(given, frames, REACH_S)
    before, _ = mean_error(given.boxes[gap], truth[gap])
    after, _ = mean_error(found.boxes[gap], truth[gap])
    assert after < 0.5 * before


def test_no_reach_or_no_boxes_change_nothing() -> None:
    given, frames = detected(noisy(standing(np.arange(9) * 0.1)))
    assert smoothed(given, frames, 0.0) is given
    assert len(smoothed(SequenceTracks.empty(), sequence([]), REACH_S).track_id) == 0
    once, frames = detected(standing(np.zeros(1)))
    assert smoothed(once, frames, REACH_S).boxes == pytest.approx(once.boxes)


def test_a_vehicle_gets_the_median_size_of_its_nearer_half() -> None:
    lengths = {10.0: 4.0, 12.0: 4.2, 14.0: 9.0, 60.0: 3.0, 62.0: 2.0}
    rows = [(f, 1, 1.0, box(x, length=s)) for f, (x, s) in enumerate(lengths.items())]
    rows.append((0, 2, 1.0, box(5, length=7.0)))
    given = tracks(rows)
    settled = settle_sizes(given, where_found(given, 5), ["car"])
    assert settled.boxes[:, 3].tolist() == [4.2] * 5 + [7.0]
    of_people = settle_sizes(given, where_found(given, 5), ["pedestrian"])
    assert of_people.boxes[:, 3].tolist() == [4.0] * 5 + [7.0]


@given(st.lists(st.tuples(st.integers(1, 4), st.floats(0.5, 20.0)), max_size=30))
def test_sizes_are_numpys_medians(rows: list[tuple[int, float]]) -> None:
    boxes = [(f, track, 1.0, box(f, length=length)) for f, (track, length) in enumerate(rows)]
    unsettled = tracks(boxes) if boxes else SequenceTracks.empty()
    settled = settle_sizes(unsettled, where_found(unsettled, len(rows)), ["pedestrian"])
    for number in range(1, 5):
        mine = unsettled.track_id == number
        if mine.any():
            assert (settled.boxes[mine, 3] == np.median(unsettled.boxes[mine, 3])).all()
