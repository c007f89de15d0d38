"""What speaks for boxes: averages by nearness in time, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from hbbatch.tracking.evidence import evidence, evidence_so_far
from hbbatch.tracking.frames import SequenceFrames
from hbbatch.tracking.tracks import SequenceTracks
from tests.tracking.drives import sequence
from tests.tracking.test_refine import box, tracks

SCORES = [1.0, 4.0, 2.0, 8.0]
TENTHS = np.array([0, 1, 2, 30])
"""Three frames close together, a fourth far from them."""


def drive() -> tuple[SequenceTracks, SequenceFrames]:
    """A track with a score in each frame, and another of a single box."""
    rows = [(f, 1, s, box(f)) for f, s in enumerate(SCORES)] + [(1, 2, 9.0, box(50))]
    frames = sequence([[]] * 4)
    stamps = {"timestamp_ns": TENTHS * 100_000_000}
    return tracks(rows), type(frames)(**{**vars(frames), **stamps})


def bell(tenths: float, width_s: float) -> float:
    return float(np.exp(-0.5 * (0.1 * tenths / width_s) ** 2))


def test_scores_nearby_weigh_by_nearness_in_time() -> None:
    known = evidence(*drive())
    one, two = bell(1, 0.3), bell(2, 0.3)
    at_0 = (1 + one * 4 + two * 2) / (1 + one + two)
    at_1 = (one * 1 + 4 + one * 2) / (1 + 2 * one)
    assert known.nearby_score[[0, 1, 3, 4]] == pytest.approx([at_0, at_1, 8.0, 9.0])
    assert known.detection_score.tolist() == [*SCORES, 9.0]


def test_online_only_what_came_before_counts() -> None:
    known = evidence_so_far(*drive())
    at_1 = (bell(1, 0.3) * 1 + 4) / (1 + bell(1, 0.3))
    assert known.nearby_score[[0, 1, 3]] == pytest.approx([1.0, at_1, 8.0])
    assert known.track_score.tolist() == pytest.approx([1, 2.5, 7 / 3, 15 / 4, 9])
    assert known.detections.tolist() == [1, 2, 3, 4, 1]


def test_presence_is_the_share_of_frames_nearby_with_a_detection() -> None:
    """The single box of track 2 in frame 1: frames 0 and 2 lie nearby without one."""
    known = evidence(*drive())
    one = bell(1, 0.5)
    assert known.presence == pytest.approx([1.0, 1.0, 1.0, 1.0, 1.0 / (1.0 + 2.0 * one)])
    so_far = evidence_so_far(*drive())
    assert so_far.presence[4] == pytest.approx(1.0 / (1.0 + one))


def test_a_row_without_detection_has_no_score_but_those_nearby() -> None:
    given, frames = drive()
    coasted = {"detection_row": np.array([0, -1, 2, 3, 4]), "score": given.score.copy()}
    coasted["score"][1] = np.nan
    known = evidence(type(given)(**{**vars(given), **coasted}), frames)
    assert np.isnan(known.detection_score[1])
    assert known.nearby_score[1] == pytest.approx(1.5)
    assert known.presence[1] < 1.0
    assert known.detections.tolist() == [3, 3, 3, 3, 1]


def test_range_is_that_from_the_sensor_seen_from_above() -> None:
    given, frames = drive()
    moved = {"translation_m": np.tile([0.0, -4.0, 7.0], (4, 1))}
    known = evidence(given, type(frames)(**{**vars(frames), **moved}))
    assert known.range_m[[0, 3]] == pytest.approx([4.0, 5.0])


def test_far_from_any_detection_the_scores_nearby_are_those_of_the_track() -> None:
    given, frames = drive()
    later = {"frame_index": np.array([0, 1, 2, 3, 1]), "detection_row": np.array([0, 1, 2, -1, 4])}
    known = evidence(type(given)(**{**vars(given), **later}), frames)
    assert known.nearby_score[3] == known.track_score[3] == pytest.approx(7 / 3)


def test_time_without_a_detection_counts_to_the_nearest_one_online_since_the_last() -> None:
    """Track 1 was detected in the frames at 0.1 and 3.0 s, and not in those at 0 and 0.2 s."""
    given, frames = drive()
    rows = {"detection_row": np.array([-1, 1, -1, 3, 4])}
    given = type(given)(**{**vars(given), **rows})
    assert evidence(given, frames).unseen_s == pytest.approx([0.1, 0.0, 0.1, 0.0, 0.0])
    late = given.take(given.frame_index > 0)
    assert evidence_so_far(late, frames).unseen_s == pytest.approx([0.0, 0.1, 0.0, 0.0])
