"""The probability of a box to be right: scales of scores, weights, their fit."""

from __future__ import annotations

import numpy as np
import pytest

from hbbatch.config import (
    ConfidenceWeights,
    KindConfidence,
    OutputSettings,
    ProtocolName,
    ScoreScale,
)
from hbbatch.tracking.confidence import (
    confidence,
    features,
    judged,
    scale_of,
    shipped_weights,
)
from hbbatch.tracking.tracks import Evidence


def told(count: int = 1, **columns: float) -> Evidence:
    """Typical evidence for `count` boxes of a detector whose typical score is 3."""
    values = {
        "detection_score": 3.0,
        "nearby_score": 3.0,
        "track_score": 3.0,
        "presence": 1.0,
        "detections": 20.0,
        "range_m": 20.0,
        "unseen_s": 0.0,
        **columns,
    }
    return Evidence(**{name: np.full(count, value) for name, value in values.items()})


SCALE = ScoreScale(typical=3.0, strong=5.0)


UNSEEN = {"detection_score": np.nan}


def probability(weights: KindConfidence, **columns: float) -> float:
    """Of one box with typical evidence but for some columns."""
    evidence = told(**columns)
    return float(judged(features(evidence, SCALE), evidence.detected, weights)[0])


def everywhere(values: list[float]) -> KindConfidence:
    """The same weights with and without a detection."""
    weights = ConfidenceWeights.from_order(values)
    return KindConfidence(detected=weights, undetected=weights)


@pytest.mark.parametrize("protocol", ["online", "gap_filled"])
@pytest.mark.parametrize("kind", ["vehicle", "pedestrian", "cyclist"])
def test_shipped_weights_trust_strong_boxes_and_doubt_weak_ones(
    kind: str, protocol: ProtocolName
) -> None:
    weights = shipped_weights(protocol)[kind]
    strong = {f"{name}_score": 5.0 for name in ("detection", "nearby", "track")}
    lasting = probability(weights, **strong, detections=50.0)
    weak = {f"{name}_score": -4.0 for name in ("detection", "nearby", "track")}
    fleeting = probability(weights, **weak, presence=0.2, detections=1.0)
    assert lasting > 0.8
    assert fleeting < 0.1


@pytest.mark.parametrize("protocol", ["online", "gap_filled"])
def test_shipped_weights_doubt_boxes_the_more_the_longer_nothing_was_detected(
    protocol: ProtocolName,
) -> None:
    weights = shipped_weights(protocol)["vehicle"]
    found = [
        probability(weights, **UNSEEN, presence=p, unseen_s=s)
        for p, s in ((0.5, 0.1), (0.2, 0.5), (0.0, 1.0))
    ]
    assert probability(weights) > found[0] > found[1] > found[2]


def test_boxes_without_a_detection_have_weights_of_their_own() -> None:
    sure = ConfidenceWeights.from_order([9.0, 0, 0, 0, 0, 0, 0, 0])
    slow = ConfidenceWeights.from_order([1.0, 5.0, 0, 0, 0, 0, 0, -2.0])
    weights = KindConfidence(detected=sure, undetected=slow)
    assert probability(weights) > 0.99
    assert probability(weights, **UNSEEN, unseen_s=0.5) == pytest.approx(0.5)
    long_ago = probability(weights, **UNSEEN, unseen_s=99.0)
    assert long_ago == pytest.approx(1 / (1 + np.exp(3.0)))
    without = KindConfidence(detected=sure)
    assert probability(without) > 0.99
    assert np.isnan(probability(without, **UNSEEN, unseen_s=0.0))


def test_a_detector_on_another_scale_is_judged_the_same() -> None:
    other = ScoreScale(typical=0.3, strong=0.5)
    tenth = {f"{name}_score": 0.2 for name in ("detection", "nearby", "track")}
    plain = {f"{name}_score": 2.0 for name in ("detection", "nearby", "track")}
    assert features(told(**tenth), other) == pytest.approx(features(told(**plain), SCALE))


def test_probabilities_are_compared_by_their_logits() -> None:
    """Half way from 0.8 to 0.95 in logits lies 0.897, not 0.875."""
    scale = ScoreScale(typical=0.8, strong=0.95, probability=True)
    logit = 0.5 * (np.log(0.8 / 0.2) + np.log(0.95 / 0.05))
    half = features(told(detection_score=1 / (1 + np.exp(-logit))), scale)
    assert half[0, 1] == pytest.approx(0.5)
    assert np.isfinite(features(told(detection_score=1.0, nearby_score=0.0), scale)).all()


def test_the_scale_is_read_from_scores_that_persist() -> None:
    scores = np.array([*np.linspace(2.0, 4.0, 101), *np.full(500, -7.0)])
    persists = np.arange(601) < 101
    scale = scale_of(scores, persists)
    assert scale == ScoreScale(typical=3.0, strong=3.6)
    assert scale_of(scores, np.zeros(601, bool)) is None
    assert scale_of(np.full(9, 0.5), np.ones(9, bool)) is None
    assert scale_of(np.linspace(0.5, 0.50001, 9), np.ones(9, bool)) is None
    as_probability = scale_of(1 / (1 + np.exp(-scores)), persists)
    assert as_probability is not None
    assert as_probability.probability


def test_without_a_scale_nothing_is_judged() -> None:
    evidence, codes = told(3), np.array([0, 1, 2])
    output = OutputSettings(score_scale={"car": SCALE, "animal": SCALE})
    found = confidence(evidence, codes, output, ["car", "pedestrian", "animal"])
    assert np.isfinite(found).tolist() == [True, False, False]


def test_weights_of_a_run_win_over_the_shipped_ones_kind_by_kind() -> None:
    never = everywhere([-9.0, 0, 0, 0, 0, 0, 0, 0])
    output = OutputSettings(
        score_scale={"car": SCALE, "pedestrian": SCALE},
        confidence={"gap_filled": {"vehicle": never}},
    )
    found = confidence(told(2), np.array([0, 1]), output, ["car", "pedestrian"])
    assert found[0] < 0.001
    assert found[1] > 0.2
