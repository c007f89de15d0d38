"""The frame loop: births, deaths, identities, and that sequences do not feel each other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hbbatch.config import TrackSettings
from hbbatch.tracking.eager_steps import scaling_factor
from hbbatch.tracking.engine import Tracker
from hbbatch.tracking.frames import SequenceFrames
from hbbatch.tracking.tracks import STATE_NAMES, SequenceTracks
from tests.tracking.drives import car, passing_cars, sequence


def settings(**changes: object) -> TrackSettings:
    return TrackSettings.model_validate({"filter": "kalman", **changes})


ONLINE = {"protocol": "online", "max_coasted": 100, "min_confidence": 0}


def track(frames: SequenceFrames, chosen: TrackSettings | None = None) -> SequenceTracks:
    (done,) = Tracker(chosen or settings()).track([frames])
    return done.tracks


def frames_of(tracks: SequenceTracks, track_id: int) -> list[int]:
    return tracks.frame_index[tracks.track_id == track_id].tolist()


def test_two_cars_keep_their_identities() -> None:
    drive = [[car(0.5 * t), car(40 - 0.5 * t, 4.0)] for t in range(30)]
    tracks = track(sequence(drive))
    assert tracks.track_count == 2
    assert frames_of(tracks, 1) == frames_of(tracks, 2) == list(range(30))
    assert np.allclose(tracks.boxes[tracks.track_id == 2][:, 1], 4.0, atol=0.05)
    assert tracks.detection_row.tolist() == list(range(60))


def test_a_gap_is_bridged_and_marked() -> None:
    drive = [[car(0.5 * t)] if not 10 <= t < 20 else [] for t in range(30)]
    filled = track(sequence(drive))
    assert filled.track_count == 1
    states = [STATE_NAMES[s] for s in filled.state]
    assert states == ["detected"] * 10 + ["interpolated"] * 10 + ["detected"] * 10
    assert filled.boxes[:, 0] == pytest.approx(0.5 * np.arange(30), abs=0.2)
    online = track(sequence(drive), settings(output=ONLINE))
    assert [STATE_NAMES[s] for s in online.state] == (
        ["detected"] * 10 + ["coasted"] * 10 + ["detected"] * 10
    )
    assert np.isnan(online.score[10:20]).all()


@pytest.mark.parametrize(("misses", "survives"), [(21, True), (22, False)])
def test_a_track_dies_after_max_misses(misses: int, survives: bool) -> None:
    drive = [[car(0)]] * 5 + [[]] * misses + [[car(0)]] * 5
    assert track(sequence(drive)).track_count == (1 if survives else 2)


@pytest.mark.parametrize(("misses", "survives"), [(4, True), (5, False)])
def test_a_track_never_matched_after_its_birth_dies_sooner(misses: int, survives: bool) -> None:
    drive = [[car(0)], *[[]] * misses, [car(0)]]
    assert track(sequence(drive)).track_count == (1 if survives else 2)


def test_a_dead_track_ends_at_its_last_detection() -> None:
    drive = [[car(0)]] * 5 + [[]] * 30
    assert frames_of(track(sequence(drive)), 1) == [0, 1, 2, 3, 4]


def test_kinds_are_not_mixed_and_classes_of_one_kind_are() -> None:
    drive = [[car(0)]] * 6
    mixed = settings(classes=["car", "van", "pedestrian"])
    by_class = [[0], [0], [1], [0], [2], [0]]
    tracks = track(sequence(drive, codes=by_class), mixed)
    assert frames_of(tracks, 1) == [0, 1, 2, 3, 4, 5]
    assert frames_of(tracks, 2) == [4]


def test_empty_sequences_give_empty_tracks() -> None:
    group = [sequence([], name="no frames"), sequence([[], [], []], name="no boxes")]
    done = list(Tracker(settings()).track(group))
    assert {d.frames.sequence_id: len(d.tracks.track_id) for d in done} == {
        "no frames": 0,
        "no boxes": 0,
    }


@pytest.mark.parametrize("name", ["kalman", "hybrid"])
@pytest.mark.parametrize("cost", ["ciou_3d", "l2"])
@pytest.mark.usefixtures("kernels")
def test_a_sequence_does_not_feel_the_others_of_its_group(name: str, cost: str) -> None:
    """Not even where boxes are there twice, so that tracks compete that are the same."""
    group = [passing_cars(n, 30 + 10 * n, name=str(n), doubled=0.4) for n in range(6)]
    tracker = Tracker(settings(filter=name, association={"cost": cost}))
    together = {d.frames.sequence_id: d.tracks for d in tracker.track(group)}
    for frames in group:
        (alone,) = tracker.track([frames])
        assert_same(alone.tracks, together[frames.sequence_id])


@pytest.mark.parametrize("name", ["kalman", "hybrid"])
@pytest.mark.usefixtures("kernels")
def test_real_drives_do_not_feel_each_other_either(test_data: Path, name: str) -> None:
    from tests.tracking.real_drives import real_frames

    group = [real_frames(test_data, s) for s in ("0000", "0003", "0012", "0014")]
    tracker = Tracker(settings(filter=name))
    together = {d.frames.sequence_id: d.tracks for d in tracker.track(group)}
    for frames in group:
        (alone,) = tracker.track([frames])
        assert_same(alone.tracks, together[frames.sequence_id])


def assert_same(first: SequenceTracks, second: SequenceTracks) -> None:
    """To the last bit: what is computed of a track does not depend on who shares the step."""
    assert first.track_id.tolist() == second.track_id.tolist()
    assert first.frame_index.tolist() == second.frame_index.tolist()
    assert first.detection_row.tolist() == second.detection_row.tolist()
    assert np.array_equal(first.boxes, second.boxes)
    assert np.array_equal(first.velocity_m_s, second.velocity_m_s)


def test_time_is_shared_out_among_sequences() -> None:
    done = list(Tracker(settings()).track([passing_cars(1), passing_cars(2, 20)]))
    assert all(d.seconds.predict > 0 and d.seconds.manage > 0 for d in done)


def test_the_scaling_factor_ramps_up_and_gives_up_while_coasting() -> None:
    damped = settings(damping={"enabled": True})
    age, misses = np.array([1, 4, 8, 30, 30, 30, 30]), np.array([0, 0, 0, 0, 11, 21, 22])
    expected = [1 / 8, 4 / 8, 1.0, 1.0, 0.5 * 0.8 + 0.1, 0.8 / 22 + 0.1, 0.1]
    assert scaling_factor(age, misses, damped) == pytest.approx(expected)


def test_damping_holds_a_young_track_back() -> None:
    drive = [[car(1.0 * t)] for t in range(4)] + [[]] * 3
    free = track(sequence(drive), settings(output=ONLINE))
    damped = track(sequence(drive), settings(output=ONLINE, damping={"enabled": True}))
    assert damped.boxes[-1, 0] < free.boxes[-1, 0] - 0.5


def test_times_between_frames_are_used() -> None:
    """Half the rate, the same speed: the same velocity."""
    slow = track(sequence([[car(2.0 * t)] for t in range(20)], dt_s=0.2))
    assert slow.velocity_m_s[-1] == pytest.approx([10.0, 0.0, 0.0], abs=0.3)
