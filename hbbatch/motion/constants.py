"""Numbers that the torch modules and their packed twins must agree on."""

from __future__ import annotations

from typing import Final

AXES: Final = 4
"""Axes with motion: along and across the heading, up, yaw."""

MAX_HEADING_VOTE: Final = 5.0

SMALLEST_SIZE_M: Final = 0.05
"""Floor of a box's length, width and height."""

RANGE_UNIT_M: Final = 50.0
FARTHEST: Final = 6.0
"""In `RANGE_UNIT_M`: noise does not grow beyond, where no detector was seen at work."""

FEATURE_LIMIT: Final = 6.0
LONGEST_TIME_S: Final = 2.0

INNOVATION_UNIT: Final = (0.3, 0.15, 0.1, 0.1, 0.2, 0.1, 0.1)
"""Rough sizes of innovations (m, rad), so that features are of order one."""

RATE_UNIT: Final = (10.0, 2.0, 0.5, 0.3, 0.3, 0.3, 0.3)
"""Rough sizes of rates in the heading frame (m/s, rad/s): centre, sizes, yaw."""

HEADS: Final = {"centre": ("along", "across"), "yaw": ("yaw",)}
"""The parallel heads of the residual predictor and the motion axes each speaks of. Up and the sizes
are left to the classical base: learned, they fit other sequences and detectors worse
(docs/accuracy.md)."""

RESIDUAL_UNIT: Final = {"along": 1.0, "across": 0.5, "yaw": 0.2}
"""What the heads say is scaled by this (m/s, m/s, rad/s)."""

LARGEST_SAID: Final = 4.0
"""Bound on what the gain network says, so that no noise factor leaves e⁻⁴ to e⁴."""
