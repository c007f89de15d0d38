"""How likely a box is right: a logistic function of what speaks for it.

Scores of detectors have scales of their own. They are made comparable by two values that
`hbbatch calibrate` finds without labels, the median and the 80 % quantile of a detector's scores on
tracks that persist; the weights of a kind of road user then serve detectors they were not made with
(docs/accuracy.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.config import (
    NEARLY_SURE,
    KindConfidence,
    OutputSettings,
    ProtocolName,
    ScoreScale,
)
from hbbatch.model.kinds import KIND_OF_CLASS
from hbbatch.tracking.frames import IntArray
from hbbatch.tracking.tracks import Evidence

SHIPPED: Final = "confidence.yaml"
"""A settings file as `hbbatch calibrate --from-labels` writes it."""

TERMS: Final = "CC BY-NC-SA 3.0 (learned from KITTI: non-commercial)"
"""Under which the shipped weights of the confidence may be used."""

_LOWEST, _HIGHEST = -4.0, 2.0
_RANGE_UNIT_M: Final = 50.0
_LONGEST_UNSEEN_S: Final = 2.0


def confidence(
    evidence: Evidence,
    class_code: IntArray,
    output: OutputSettings,
    class_names: Sequence[str],
) -> FloatArray:
    """Probability of each row's box to be right, `(n,)`; NaN where that cannot be judged.

    It cannot where the class has no score scale, or its kind no weights for boxes like this one.

    Args:
        evidence: of each row.
        class_code: `(n,)` index into `class_names`.
        output: score scales and, where they differ from the shipped ones, weights.
        class_names: of the codes.
    """
    probability = np.full(len(class_code), np.nan)
    own = output.confidence.get(output.protocol, {})
    weights = {**shipped_weights(output.protocol), **own}
    for code, name in enumerate(class_names):
        scale = output.score_scale.get(name)
        of_kind = weights.get(KIND_OF_CLASS.get(name, ""))
        if scale is None or of_kind is None:
            continue
        rows = class_code == code
        of_class = evidence.take(rows)
        probability[rows] = judged(features(of_class, scale), of_class.detected, of_kind)
    return probability


@cache
def shipped_weights(protocol: ProtocolName) -> Mapping[str, KindConfidence]:
    """The weights in the package, by kind of road user; read once a process."""
    import yaml  # not before it is needed: most runs judge no box

    content: Mapping[str, Any] = yaml.safe_load((files(__package__) / SHIPPED).read_text())
    kinds: Mapping[str, Any] = content["output"]["confidence"][protocol]
    return {kind: KindConfidence.model_validate(values) for kind, values in kinds.items()}


def features(evidence: Evidence, scale: ScoreScale) -> FloatArray:
    """`(n, 8)` in the order of `ConfidenceWeights`, the first column ones.

    What a box has not, a detection or time without one, is 0.
    """
    return np.stack(
        [
            np.ones(len(evidence.range_m)),
            np.nan_to_num(_comparable(evidence.detection_score, scale)),
            _comparable(evidence.nearby_score, scale),
            _comparable(evidence.track_score, scale),
            evidence.presence,
            np.log(np.maximum(evidence.detections, 1.0)),
            evidence.range_m / _RANGE_UNIT_M,
            np.minimum(evidence.unseen_s, _LONGEST_UNSEEN_S),
        ],
        axis=1,
    )


def judged(given: FloatArray, detected: NDArray[np.bool_], weights: KindConfidence) -> FloatArray:
    """Logistic function of `features` `(n, 8)`, `(n,)`; NaN where there are no weights for it.

    Args:
        given: `features`.
        detected: `(n,)` which boxes have a detection.
        weights: for those that have, and those that have not.
    """
    probability = np.full(len(given), np.nan)
    for rows, of_rows in ((detected, weights.detected), (~detected, weights.undetected)):
        if of_rows is not None:
            evidence = given[rows] @ np.array(of_rows.in_order())
            probability[rows] = np.exp(-np.logaddexp(0.0, -evidence))
    return probability


def scale_of(scores: FloatArray, persists: NDArray[np.bool_]) -> ScoreScale | None:
    """The scale of a detector's scores from those whose tracks persist, to four decimals.

    None if no score persists, or those that do are too much alike.
    """
    if not persists.any():
        return None
    probability = bool(scores.min() >= 0.0 and scores.max() <= 1.0)
    typical, strong = np.round(np.quantile(scores[persists], [0.5, 0.8]), 4)
    if not _linear(typical, probability) < _linear(strong, probability):
        return None
    return ScoreScale(typical=float(typical), strong=float(strong), probability=probability)


def _comparable(score: FloatArray, scale: ScoreScale) -> FloatArray:
    ends = np.array([scale.typical, scale.strong])
    typical, strong = _linear(ends, scale.probability)
    place: FloatArray = (_linear(score, scale.probability) - typical) / (strong - typical)
    return np.clip(place, _LOWEST, _HIGHEST)


def _linear(score: FloatArray, probability: bool) -> FloatArray:
    """Scores as they are, or the logit of probabilities, which crowd at one end."""
    if not probability:
        return score
    kept = np.clip(score, *NEARLY_SURE)
    logit: FloatArray = np.log(kept / (1.0 - kept))
    return logit
