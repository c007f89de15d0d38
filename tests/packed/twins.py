"""Packed twins of torch modules, with the parameters they have now."""

from __future__ import annotations

from hbbatch.model.hybrid import HybridFilter
from hbbatch.model.kalman import KalmanFilter
from hbbatch.packed.filters import packed_filter
from hbbatch.packed.kalman import PackedKalman


def packed(motion: KalmanFilter | HybridFilter) -> PackedKalman:
    parameters = {name: value.numpy() for name, value in motion.state_dict().items()}
    if isinstance(motion, KalmanFilter):
        return packed_filter("kalman", motion.class_names, {"model": motion.model}, parameters)
    learned = [bool(flag) for flag in motion.learned.flatten()]
    options = {"motion_model": motion.base.model, "learned": learned}
    return packed_filter("hybrid", motion.class_names, options, parameters)
