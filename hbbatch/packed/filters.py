"""A packed filter from what a weights file holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hbbatch.errors import WeightsError
from hbbatch.motion.parameters import HybridOptions, KalmanOptions, Parameters, misfit
from hbbatch.packed.hybrid import PackedHybrid
from hbbatch.packed.kalman import PackedKalman


def packed_filter(
    name: str, kinds: Sequence[str], options: Mapping[str, Any], parameters: Parameters
) -> PackedKalman:
    """The packed twin of `model.weights.build_filter`'s module with these parameters.

    Args:
        name: "hybrid" or "kalman".
        kinds: groups of road users the filter has parameters for.
        options: of the filter, as its weights name them.
        parameters: arrays by name.

    Raises:
        WeightsError: options or parameters are not this version's.
    """
    try:
        chosen = KalmanOptions(**options) if name == "kalman" else HybridOptions(**options)
        if isinstance(chosen, HybridOptions):
            chosen.learned_kinds(len(kinds))
    except TypeError as error:
        raise WeightsError(f"unknown filter options ({error})") from error
    wrong = misfit(parameters, chosen.shapes(len(kinds)))
    if wrong is not None:
        raise WeightsError(wrong)
    if isinstance(chosen, KalmanOptions):
        return PackedKalman(parameters, chosen)
    return PackedHybrid(parameters, len(kinds), chosen)
