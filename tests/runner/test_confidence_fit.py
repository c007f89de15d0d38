"""Weights of the confidence from boxes known to be right or wrong."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from hbbatch.config import ConfidenceWeights
from hbbatch.runner.confidence_fit import fit


def test_the_fit_is_that_of_an_optimiser_without_slopes() -> None:
    rng = np.random.default_rng(0)
    given = np.column_stack([np.ones(2000), rng.normal(size=(2000, 7))])
    true = np.array([0.5, 1.0, -2.0, 0.3, 0.0, 1.5, -0.7, 0.2])
    right = rng.random(2000) < 1 / (1 + np.exp(-given @ true))
    weight = rng.uniform(0.5, 1.5, 2000)

    def loss(w: np.ndarray) -> float:
        score = given @ w
        likelihood = np.average(np.logaddexp(0, score) - right * score, weights=weight)
        return float(likelihood + 0.5e-3 * (w[1:] @ w[1:]))

    expected = minimize(loss, np.zeros(8), method="L-BFGS-B").x
    found = fit(given, right, weight).in_order()
    assert found == pytest.approx(expected, abs=2e-3)
    assert found == pytest.approx(true, abs=0.35)


def test_few_rows_stay_near_their_prior_and_many_speak_for_themselves() -> None:
    rng = np.random.default_rng(1)
    given = np.column_stack([np.ones(20_000), rng.normal(size=(20_000, 7))])
    right = rng.random(20_000) < 1 / (1 + np.exp(-2.0 * given[:, 1]))
    prior = ConfidenceWeights.from_order([0.0, 0.0, 0, 0, 0, 0, 1.0, 0])
    few = fit(given[:30], right[:30], np.ones(30), prior)
    many = fit(given, right, np.ones(20_000), prior)
    assert abs(few.detection_score) < 1.0 < 1.8 < many.detection_score
    assert few.range > 0.2
    assert abs(many.range) < 0.1


def test_boxes_that_can_be_told_apart_without_fail_do_not_run_away() -> None:
    """A few right boxes, all stronger than the wrong ones, far from a prior that is sure."""
    given = np.column_stack([np.ones(40), np.repeat([-3.0, 1.5], 20), np.zeros((40, 6))])
    prior = ConfidenceWeights.from_order([-9.0, 0.5, 2.0, 0, 0, 0, 0, 0])
    found = fit(given, given[:, 1] > 0, np.ones(40), prior)
    assert 0.5 < found.detection_score < 9.0
    assert np.abs(found.in_order()).max() < 10.0
