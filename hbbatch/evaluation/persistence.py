"""Which detections persist: what is known of a detector without labels.

A detection of a true object is followed by others in most of the next frames; false ones mostly are
not. So scores of detections in long, dense tracks are, most of them, scores of true objects.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

_LONG_DETECTIONS: Final = 10
_DENSE: Final = 0.8


def persistent(tracks: pa.Table) -> NDArray[np.bool_]:
    """Whether each row of uncut tracks (`schema.TRACKS`) belongs to a long, dense track."""
    _, track = np.unique(tracks["track_id"].to_numpy(), return_inverse=True)
    seen = ~np.isnan(tracks["score"].to_numpy())
    frame = tracks["frame_index"].to_numpy()
    count = np.bincount(track, seen)
    first, last = np.full(len(count), np.inf), np.full(len(count), -np.inf)
    np.minimum.at(first, track[seen], frame[seen])
    np.maximum.at(last, track[seen], frame[seen])
    long = (count >= _LONG_DETECTIONS) & (count > _DENSE * (last - first + 1))
    return np.asarray(long[track], bool)
