"""The tracker as a whole: whatever it is given as boxes, it gives numbers back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hbbatch.boxes import LARGEST
from hbbatch.config import TrackSettings
from hbbatch.tracking.engine import Tracker
from tests.tracking.drives import passing_cars


@pytest.mark.parametrize("name", ["hybrid", "kalman"])
@pytest.mark.parametrize("protocol", ["online", "gap_filled"])
def test_the_largest_boxes_there_can_be_leave_tracks_finite(name: str, protocol: str) -> None:
    settings = TrackSettings.model_validate({"filter": name, "output": {"protocol": protocol}})
    tracker, drive = Tracker(settings), passing_cars(seed=0)
    for column in range(7):
        boxes = drive.boxes.copy()
        boxes[10::7, column] = LARGEST
        absurd = replace(drive, boxes=boxes, sight_m=boxes[:, :3].copy())
        [done] = tracker.track([absurd])
        assert np.isfinite(done.tracks.boxes).all()
        assert np.isfinite(done.tracks.velocity_m_s).all()
