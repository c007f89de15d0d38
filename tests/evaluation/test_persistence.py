"""Which detections persist."""

from __future__ import annotations

import pyarrow as pa

from hbbatch.evaluation.persistence import persistent


def test_long_dense_tracks_persist() -> None:
    """Track 1 is long and dense, 2 short, 3 long with too many holes, 4 only just dense enough.

    What is said of a track before and after its detections makes it no less dense.
    """
    frames = {1: range(10), 2: range(9), 3: range(0, 20, 2), 4: [*range(9), 11]}
    rows = [(track, frame, 1.0) for track, of_track in frames.items() for frame in of_track]
    rows += [(4, frame, None) for frame in (9, 10, -3, 15)]
    track, frame, score = zip(*rows, strict=True)
    table = pa.table({"track_id": track, "frame_index": frame, "score": pa.array(score)})
    found = persistent(table)
    assert {t for t, lasts in zip(track, found, strict=True) if lasts} == {1, 4}
    assert found.sum() == 24
