"""What there was to find in a simulated drive, as the labels table."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from hbbatch import schema
from hbbatch.boxes import BOX_FIELDS
from hbbatch.synthetic.drive import Drive, DriveFrame
from hbbatch.synthetic.sensor import View
from hbbatch.synthetic.settings import CLASS_NAMES

MIN_VISIBLE: Final = 0.15
MIN_POINTS: Final = 10.0
_BEYOND_RANGE_M: Final = 10.0
_HIDDEN: Final = 3


def labels_table(drive: Drive, frame_id: str, longest_hidden_s: float = math.inf) -> pa.Table:
    """All objects within reach of the sensor, a row an object and frame (`schema.LABELS`).

    The occlusion level follows the share that is visible: 0 from 80%, 1 from 40%, 2 from
    `MIN_VISIBLE`. Objects that the sensor could not have seen (less visible, fewer than
    `MIN_POINTS` lidar points expected on them, out of the field of view, or up to 10 m beyond the
    range) have level 3: evaluation lets a tracker say them or not.

    Args:
        drive: the drive.
        frame_id: name of the sensor frame.
        longest_hidden_s: objects that the sensor could not have seen for longer than twice this
            are labelled so long before and after only, as by people who label what they see.
    """
    kept = _near_in_time(
        np.array([occlusion_levels(frame.seen) < _HIDDEN for frame in drive.frames]),
        longest_hidden_s * drive.settings.rate_hz,
    )
    rows = [
        _frame_rows(drive, index, frame, kept[index]) for index, frame in enumerate(drive.frames)
    ]
    merged = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    names = pa.array(np.array(CLASS_NAMES, dtype=object)[merged.pop("class_code")], pa.string())
    columns = {name: pa.array(values) for name, values in merged.items()}
    columns |= {"class_name": names, "class_name_logged": names}
    columns["frame_id"] = pa.array([frame_id] * len(names), pa.string())
    return schema.conform(pa.table(columns), schema.LABELS, "labels of the simulated drive")


def occlusion_levels(seen: View) -> NDArray[np.int32]:
    """KITTI's occlusion level of each object, 3 where the sensor could not have seen it."""
    levels = np.select([seen.visible >= 0.8, seen.visible >= 0.4, seen.visible >= MIN_VISIBLE],
                       [0, 1, 2], _HIDDEN)  # fmt: skip
    levels[seen.points < MIN_POINTS] = _HIDDEN
    return levels.astype(np.int32)


def _near_in_time(seen: NDArray[np.bool_], frames: float) -> NDArray[np.bool_]:
    """Which `(frames, objects)` lie at most so many frames before or after a seen one."""
    if math.isinf(frames):
        return np.ones_like(seen)
    width = 2 * int(frames) + 1
    return np.asarray(maximum_filter1d(seen.astype(np.uint8), width, axis=0, mode="constant") > 0)


def _frame_rows(
    drive: Drive, index: int, frame: DriveFrame, wanted: NDArray[np.bool_]
) -> dict[str, NDArray[np.generic]]:
    reach = drive.settings.sensor.range_m + _BEYOND_RANGE_M
    kept = np.flatnonzero(wanted & (frame.seen.range_m <= reach))
    count = len(kept)
    boxes = frame.seen.boxes[kept]
    return {
        "frame_index": np.full(count, index, np.int32),
        "timestamp_ns": np.full(count, frame.timestamp_ns, np.int64),
        "object_id": kept.astype(np.int64),
        "class_code": drive.class_codes[kept],
        **{name: boxes[:, column] for column, name in enumerate(BOX_FIELDS)},
        "truncation": np.zeros(count),
        "occlusion": occlusion_levels(frame.seen)[kept],
    }
