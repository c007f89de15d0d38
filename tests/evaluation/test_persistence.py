"""Score cuts without labels: a simulated detector whose false detections do not persist."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from hbbatch.evaluation.persistence import score_cuts


def tracks(scale: float, shift: float, seed: int = 0) -> pa.Table:
    """Long tracks scored around 2, short ones around −2, on a scale of the detector's own."""
    rng = np.random.default_rng(seed)
    frame, track, score = [], [], []
    for number in range(400):
        true = number % 4 == 0
        length = 40 if true else int(rng.integers(1, 4))
        frame += range(length)
        track += [number] * length
        score += (rng.normal(2.0 if true else -2.0, 1.0, length) * scale + shift).tolist()
    return pa.table(
        {
            "frame_index": pa.array(frame, pa.int32()),
            "track_id": track,
            "score": score,
            "class_name": ["car"] * len(frame),
        }
    )


def test_the_cut_lies_between_false_and_true_detections() -> None:
    cuts = score_cuts([tracks(1.0, 0.0)], "car")
    assert cuts is not None
    assert cuts.local is not None
    assert cuts.track is not None
    assert -1.5 < cuts.local < cuts.track < 1.0


def test_the_cut_follows_the_scale_of_the_detector() -> None:
    """The same detector on another scale: the same boxes are cut."""
    plain, scaled = score_cuts([tracks(1.0, 0.0)], "car"), score_cuts([tracks(0.1, 5.0)], "car")
    assert plain is not None
    assert scaled is not None
    assert scaled.track == pytest.approx(0.1 * plain.track + 5.0)
    assert scaled.local == pytest.approx(0.1 * plain.local + 5.0)


def test_a_detector_without_false_detections_is_left_uncut() -> None:
    table = tracks(1.0, 0.0)
    clean = table.filter(pc.less(pc.bit_wise_and(table["track_id"], 3), 1))
    assert score_cuts([clean], "car") == (None, None, clean.num_rows)


def test_too_few_detections_say_nothing() -> None:
    assert score_cuts([tracks(1.0, 0.0).slice(0, 100)], "car") is None
    assert score_cuts([tracks(1.0, 0.0)], "pedestrian") is None
