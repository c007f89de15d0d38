"""What happens to tracks once a sequence is over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hbbatch.config import OutputSettings, ScoreScale
from hbbatch.tracking.evidence import score_so_far
from hbbatch.tracking.frames import SequenceFrames
from hbbatch.tracking.refine import fill_gaps, refine
from hbbatch.tracking.tracks import SequenceTracks, TrackState
from tests.tracking.drives import sequence


def tracks(rows: list[tuple[int, int, float, list[float]]]) -> SequenceTracks:
    """From (frame, track, score, box)."""
    frame, track, score, boxes = zip(*rows, strict=True)
    count = len(rows)
    return SequenceTracks(
        frame_index=np.array(frame),
        track_id=np.array(track),
        class_code=np.zeros(count, int),
        state=np.zeros(count, np.int8),
        score=np.array(score),
        boxes=np.array(boxes, float),
        velocity_m_s=np.zeros((count, 3)),
        detection_row=np.arange(count),
    )


def where_found(given: SequenceTracks, frame_count: int) -> SequenceFrames:
    """A sequence in which the boxes of `tracks` were detected as they are."""
    return replace(sequence([[]] * frame_count), boxes=given.boxes, sight_m=given.boxes[:, :3])


def box(x: float, yaw: float = 0.0, length: float = 4.0) -> list[float]:
    return [x, 0, 0, length, 2, 1.5, yaw]


def test_gaps_are_interpolated_in_time_and_the_short_way_round() -> None:
    frames = sequence([[]] * 5)
    uneven = np.array([0, 1, 2, 3, 8]) * 100_000_000
    frames = type(frames)(**{**vars(frames), "timestamp_ns": uneven})
    given = tracks([(0, 1, 1.0, box(0, 3.0)), (4, 1, 1.0, box(8, -3.0))])
    filled = fill_gaps(given, frames)
    assert filled.frame_index.tolist() == [0, 1, 2, 3, 4]
    assert filled.boxes[:, 0] == pytest.approx([0, 1, 2, 3, 8])
    turned = 3.0 + np.array([1, 2, 3]) / 8 * (2 * np.pi - 6.0)
    assert np.cos(filled.boxes[1:4, 6] - turned) == pytest.approx(1.0)
    assert filled.state.tolist() == [0, *[TrackState.INTERPOLATED] * 3, 0]
    assert filled.detection_row.tolist() == [0, -1, -1, -1, 1]


def test_filling_does_not_bridge_two_tracks() -> None:
    given = tracks([(0, 1, 1.0, box(0)), (4, 2, 1.0, box(8))])
    assert len(fill_gaps(given, sequence([[]] * 5)).track_id) == 2


def test_short_and_low_scored_tracks_are_left_out() -> None:
    given = tracks(
        [(0, 1, 0.9, box(0)), (1, 1, 0.1, box(0)), (0, 2, 0.3, box(5)), (1, 3, 2.0, box(9))]
    )
    frames = where_found(given, 2)
    kept = refine(given, frames, OutputSettings(min_detections=2), ["car"]).tracks
    assert set(kept.track_id) == {1}
    done = refine(given, frames, OutputSettings(min_track_score=0.5), ["car"])
    assert set(done.tracks.track_id) == {1, 3}
    assert done.track_score.tolist() == [0.5, 0.5, 2.0]


def test_online_a_box_is_judged_by_what_was_known_in_its_frame() -> None:
    rows = [(0, 1, 0.0, box(0)), (0, 2, 4.0, box(5)), (1, 1, 1.0, box(0)), (2, 1, 5.0, box(0))]
    assert score_so_far(tracks(rows)).track_score.tolist() == [0.0, 4.0, 0.5, 2.0]
    assert score_so_far(tracks(rows)).detections.tolist() == [1, 1, 2, 3]
    chosen = OutputSettings(protocol="online", min_track_score=1.0)
    said = refine(tracks(rows), sequence([[]] * 3), chosen, ["car"]).tracks
    assert list(zip(said.track_id, said.frame_index, strict=True)) == [(2, 0), (1, 2)]


def test_online_boxes_are_left_as_they_were_said() -> None:
    given = tracks([(0, 1, 1.0, box(0)), (2, 1, 1.0, box(2, length=5.0))])
    said = refine(given, sequence([[]] * 3), OutputSettings(protocol="online"), ["car"]).tracks
    assert said.boxes == pytest.approx(given.boxes)


@pytest.mark.parametrize("protocol", ["online", "gap_filled"])
def test_nothing_stays_nothing(protocol: str) -> None:
    done = refine(
        SequenceTracks.empty(),
        sequence([[]]),
        OutputSettings.model_validate({"protocol": protocol}),
        ["car"],
    )
    assert len(done.tracks.track_id) == 0


def test_boxes_are_dropped_where_the_track_is_unlikely_to_have_its_object() -> None:
    """Twenty frames of strong scores, then twenty of very weak ones."""
    rows = [(f, 1, 5.0 if f < 20 else -9.0, box(f)) for f in range(40)]
    judging = OutputSettings(score_scale={"car": ScoreScale(typical=3.0, strong=5.0)})
    given = tracks(rows)
    done = refine(given, where_found(given, 40), judging, ["car"])
    assert done.tracks.frame_index.tolist() == list(range(done.tracks.frame_index[-1] + 1))
    assert 17 <= done.tracks.frame_index[-1] < 20
    assert (done.confidence >= 0.5).all()
    everything = judging.model_copy(update={"min_confidence": 0.0})
    judged = refine(given, where_found(given, 40), everything, ["car"])
    assert len(judged.confidence) == 40
    assert judged.confidence[10] > 0.9
    assert judged.confidence[30] < 0.1


@pytest.mark.parametrize("protocol", ["online", "gap_filled"])
def test_classes_without_a_score_scale_are_written_unjudged(protocol: str) -> None:
    given = tracks([(0, 1, -9.0, box(0)), (0, 2, -9.0, box(9))])
    given = type(given)(**{**vars(given), "class_code": np.array([0, 1])})
    scale = {"car": {"typical": 3.0, "strong": 5.0}}
    output = OutputSettings.model_validate({"protocol": protocol, "score_scale": scale})
    done = refine(given, where_found(given, 1), output, ["car", "pedestrian"])
    assert done.tracks.track_id.tolist() == [2]
    assert np.isnan(done.confidence).all()


def test_cuts_can_differ_by_class() -> None:
    given = tracks([(0, 1, 1.0, box(0)), (0, 2, 1.0, box(9)), (0, 3, 1.0, box(30))])
    given = type(given)(**{**vars(given), "class_code": np.array([0, 1, 2])})
    chosen = OutputSettings(min_track_score={"car": 2.0, "pedestrian": 0.5})
    names = ["car", "pedestrian", "cyclist"]
    done = refine(given, where_found(given, 1), chosen, names)
    assert done.tracks.track_id.tolist() == [2, 3]


def predicted(state: TrackState) -> SequenceTracks:
    """Ten frames of strong scores, then five predictions."""
    rows = [(f, 1, 5.0 if f < 10 else np.nan, box(f)) for f in range(15)]
    given = tracks(rows)
    undetected = np.arange(15) >= 10
    states = np.where(undetected, state, TrackState.DETECTED).astype(np.int8)
    detection = np.where(undetected, -1, np.arange(15))
    return type(given)(**{**vars(given), "state": states, "detection_row": detection})


def test_predictions_are_written_only_where_they_are_judged_likely() -> None:
    given, frames = predicted(TrackState.COASTED), sequence([[]] * 15)
    unjudged = OutputSettings(protocol="online")
    assert refine(given, frames, unjudged, ["car"]).tracks.frame_index.max() == 9
    scale = {"car": ScoreScale(typical=3.0, strong=5.0)}
    judging = OutputSettings(protocol="online", score_scale=scale)
    done = refine(given, frames, judging, ["car"])
    assert done.tracks.frame_index.max() < 14
    assert (done.confidence >= 0.5).all()
    everything = judging.model_copy(update={"min_confidence": 0.0, "score_scale": {}})
    assert refine(given, frames, everything, ["car"]).tracks.frame_index.max() == 14


def test_interpolated_boxes_are_written_unjudged_as_well() -> None:
    given = tracks([(0, 1, 1.0, box(0)), (4, 1, 1.0, box(8))])
    done = refine(given, where_found(given, 5), OutputSettings(), ["car"])
    assert len(done.tracks.track_id) == 5
    assert np.isnan(done.confidence).all()


def test_tracks_begin_before_their_first_detection_where_that_is_likely() -> None:
    rows = [(f, 1, 6.0, box(70.0 - f)) for f in range(10, 40)]
    scale = {"car": ScoreScale(typical=3.0, strong=5.0)}
    given = tracks(rows)
    frames = where_found(given, 40)
    done = refine(given, frames, OutputSettings(score_scale=scale), ["car"])
    before = done.tracks.take(done.tracks.frame_index < 10)
    assert 0 < len(before.track_id) <= 10
    assert set(before.state.tolist()) == {TrackState.EXTRAPOLATED}
    assert before.boxes[:, 0] == pytest.approx(70.0 - before.frame_index)
    none = OutputSettings(score_scale=scale, lead_in_s=0.0)
    assert refine(given, frames, none, ["car"]).tracks.frame_index.min() == 10
