"""Boxes before a track's first detection."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hbbatch.tracking.lead_in import add_lead_ins
from hbbatch.tracking.tracks import SequenceTracks, TrackState
from tests.tracking.test_refine import box, tracks

TENTH_NS = 100_000_000


def track(first: int, last: int, number: int = 1, speed: float = 1.0) -> SequenceTracks:
    """A box a frame, `speed` metres further along x in each."""
    return tracks([(f, number, 1.0, box(speed * f, yaw=0.3)) for f in range(first, last + 1)])


def test_a_track_is_continued_backwards_along_its_first_motion() -> None:
    stamps = np.arange(20) * TENTH_NS
    found = add_lead_ins(track(5, 15), stamps, reach_s=0.3)
    assert found.frame_index.tolist() == list(range(2, 16))
    assert found.boxes[:, 0] == pytest.approx(found.frame_index)
    before = found.take(found.frame_index < 5)
    assert before.state.tolist() == [TrackState.EXTRAPOLATED] * 3
    assert before.velocity_m_s == pytest.approx(np.tile([10.0, 0.0, 0.0], (3, 1)))
    assert before.boxes[:, 6] == pytest.approx(0.3)
    assert before.detection_row.tolist() == [-1] * 3
    assert np.isnan(before.score).all()


def test_it_ends_at_the_start_of_the_sequence() -> None:
    stamps = np.arange(20) * TENTH_NS
    assert add_lead_ins(track(2, 10), stamps, reach_s=1.0).frame_index.tolist() == list(range(11))
    assert len(add_lead_ins(track(0, 10), stamps, reach_s=1.0).track_id) == 11


def test_frames_count_by_their_time() -> None:
    stamps = np.array([0, 1, 8, 9, 10, 11, 12]) * TENTH_NS
    found = add_lead_ins(track(3, 6), stamps, reach_s=0.5)
    assert found.frame_index.tolist() == [2, 3, 4, 5, 6]
    slow = add_lead_ins(track(3, 6), stamps, reach_s=1.0)
    assert slow.boxes[:3, 0] == pytest.approx([3 - 9, 3 - 8, 3 - 1])


def test_the_first_second_tells_the_motion_and_the_first_box_the_rest() -> None:
    """A metre a frame for a second, then at rest; it turns and grows all the while."""
    rows = [
        (f, 1, 1.0, box(float(min(f, 15)), yaw=0.1 * f, length=4.0 + 0.1 * f)) for f in range(5, 40)
    ]
    found = add_lead_ins(tracks(rows), np.arange(40) * TENTH_NS, reach_s=0.3)
    before = found.take(found.frame_index < 5)
    assert before.boxes[:, 0] == pytest.approx([2, 3, 4])
    assert before.boxes[:, 6] == pytest.approx([0.5] * 3)
    assert before.boxes[:, 3] == pytest.approx([4.5] * 3)


def test_at_low_rates_the_first_three_detections_tell_the_motion() -> None:
    stamps = np.arange(20) * 10 * TENTH_NS
    found = add_lead_ins(track(5, 8), stamps, reach_s=2.0)
    assert found.frame_index.tolist() == list(range(3, 9))
    assert found.boxes[:, 0] == pytest.approx(found.frame_index)


def test_nothing_is_said_of_a_motion_nobody_saw() -> None:
    stamps = np.arange(20) * TENTH_NS
    assert len(add_lead_ins(track(5, 6), stamps, reach_s=1.0).track_id) == 2
    gap = track(5, 12)
    gap = replace(gap, detection_row=np.where(np.arange(8) % 7 == 0, np.arange(8), -1))
    assert len(add_lead_ins(gap, stamps, reach_s=1.0).track_id) == 8, "detected twice only"
    assert len(add_lead_ins(track(5, 9), stamps * 0, reach_s=1.0).track_id) == 5, "no clock"
    assert len(add_lead_ins(track(5, 9), stamps, reach_s=0.0).track_id) == 5
    assert len(add_lead_ins(SequenceTracks.empty(), stamps, reach_s=1.0).track_id) == 0
    assert len(add_lead_ins(SequenceTracks.empty(), stamps[:0], reach_s=1.0).track_id) == 0


@given(
    st.lists(
        st.tuples(st.integers(0, 12), st.integers(0, 7), st.floats(-3, 3)), min_size=1, max_size=5
    )
)
@settings(max_examples=50, deadline=None)
def test_tracks_do_not_mind_each_other(asked: list[tuple[int, int, float]]) -> None:
    """All at once gives what each alone gives, and leaves what was there."""
    stamps = np.arange(20) * TENTH_NS
    alone = [
        track(first, first + more, number + 1, speed)
        for number, (first, more, speed) in enumerate(asked)
    ]
    together = alone[0]
    for other in alone[1:]:
        together = together.joined(other)
    found = add_lead_ins(together, stamps, reach_s=0.6)
    for number, of_track in enumerate(alone):
        expected = add_lead_ins(of_track, stamps, reach_s=0.6)
        mine = found.take(found.track_id == number + 1)
        assert mine.frame_index.tolist() == expected.frame_index.tolist()
        assert mine.boxes == pytest.approx(expected.boxes)
        kept = mine.take(mine.state == TrackState.DETECTED)
        assert kept.boxes == pytest.approx(of_track.boxes)
