"""placeholder."""

from __future__ import annotations

from hbbatch.model.kalman import KalmanFilter


class HybridFilter(KalmanFilter):
    """placeholder."""
