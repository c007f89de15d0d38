"""Weights of the confidence, fitted to boxes that labels call right or wrong."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from hbbatch.boxes import FloatArray
from hbbatch.config import ConfidenceWeights

_RIDGE: Final = 1e-3
_PRIOR_ROWS: Final = 10.0
"""How hard a fit of n rows is pulled towards its prior: this many over n."""


def fit(
    given: FloatArray,
    right: NDArray[np.bool_],
    weight: FloatArray,
    prior: ConfidenceWeights | None = None,
) -> ConfidenceWeights:
    """Weights by weighted maximum likelihood, with a ridge.

    Args:
        given: `features` `(n, 8)`.
        right: `(n,)` whether the box is right.
        weight: `(n,)` how much each row counts.
        prior: what the ridge pulls towards, the harder the fewer rows there are; by default
            slightly towards none.
    """
    weight = weight / weight.sum()
    columns = given.shape[1]
    if prior is None:
        start, ridge = np.zeros(columns), _RIDGE * np.array([0.0, *np.ones(columns - 1)])
    else:
        start = np.array(prior.in_order())
        ridge = np.full(columns, _RIDGE + _PRIOR_ROWS / len(given))

    def loss(solution: FloatArray) -> tuple[float, FloatArray]:
        evidence, pull = given @ solution, solution - start
        surprise = np.logaddexp(0.0, evidence) - right * evidence
        slope = given.T @ (weight * (expit(evidence) - right)) + ridge * pull
        return float(weight @ surprise + 0.5 * pull @ (ridge * pull)), slope

    solution = minimize(loss, start, jac=True, method="BFGS", options={"gtol": 1e-6}).x
    return ConfidenceWeights.from_order([round(float(value), 4) for value in solution])
