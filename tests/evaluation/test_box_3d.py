"""3D boxes by the same rules: what the sensor could not see may be tracked or not."""

from __future__ import annotations

import sys

import numpy as np
import pyarrow as pa
import pytest

from hbbatch.boxes import BOX_FIELDS
from hbbatch.errors import MissingExtraError, SequenceError
from hbbatch.evaluation import metrics
from hbbatch.evaluation.box_3d import evaluate_boxes
from hbbatch.evaluation.results import Scores

FRAMES = 8
BOXES = np.tile([-12.0, 40.0, 0.5, 4.0, 1.8, 1.5, 2.0], (FRAMES, 1))


def labels(occlusion: list[int], truncation: float = 0.0) -> pa.Table:
    return pa.table(
        {
            "frame_index": np.arange(FRAMES),
            "object_id": np.full(FRAMES, 3),
            "class_name": ["car"] * FRAMES,
            **{name: BOXES[:, i] for i, name in enumerate(BOX_FIELDS)},
            "occlusion": occlusion,
            "truncation": np.full(FRAMES, truncation),
        }
    )


def tracks(frames: range, boxes: np.ndarray = BOXES, class_name: str = "car") -> pa.Table:
    rows = list(frames)
    return pa.table(
        {
            "frame_index": np.array(rows, dtype=np.int64),
            "track_id": np.ones(len(rows), int),
            "class_name": pa.array([class_name] * len(rows), pa.string()),
            "track_score": np.ones(len(rows)),
            **{f"sensor_{name}": boxes[rows, i] for i, name in enumerate(BOX_FIELDS)},
        }
    )


def score(truth: pa.Table, found: pa.Table) -> Scores:
    return evaluate_boxes({"a": truth}, {"a": found}, ["car"]).classes["car"].combined


def test_hidden_objects_may_be_tracked_or_not() -> None:
    hidden_at_the_end = labels([0] * 5 + [3] * 3)
    through, cut = (score(hidden_at_the_end, tracks(range(end))) for end in (FRAMES, 5))
    assert through == cut
    assert (cut.labelled_boxes, cut.fp, cut.fn) == (5, 0, 0)
    assert cut.hota == pytest.approx(100.0)


def test_occlusion_and_truncation_count_from_kittis_levels() -> None:
    assert score(labels([2] * FRAMES), tracks(range(0))).fn == FRAMES
    assert score(labels([0] * FRAMES, truncation=1.0), tracks(range(0))).fn == 0


def test_a_box_somewhere_else_or_of_another_class_is_false() -> None:
    truth = labels([0] * FRAMES)
    aside = BOXES + np.array([0.0, 3.0, 0, 0, 0, 0, 0])
    scores = score(truth, tracks(range(FRAMES), aside))
    assert (scores.fp, scores.fn) == (FRAMES, FRAMES)
    other = score(truth, tracks(range(FRAMES), class_name="truck"))
    assert (other.fp, other.fn, other.tracks) == (0, FRAMES, 0)


def test_two_boxes_of_a_track_in_a_frame_are_refused() -> None:
    twice = pa.concat_tables([tracks(range(FRAMES)), tracks(range(FRAMES))])
    with pytest.raises(SequenceError, match=r"sequence a: .*unique within a frame"):
        score(labels([0] * FRAMES), twice)


def test_without_trackeval_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "trackeval", None)
    metrics._trackeval.cache_clear()
    with pytest.raises(MissingExtraError, match=r"pip install 'hbbatch\[eval\]'"):
        metrics._trackeval()
