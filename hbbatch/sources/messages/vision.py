"""vision_msgs (ROS 2, Galactic on)."""

from __future__ import annotations

from typing import Any

import numpy as np

from hbbatch.boxes import FloatArray
from hbbatch.sources.messages.base import DetectionMessage, quaternion_yaw, stamp_ns


def detection_3d_array(message: Any) -> DetectionMessage:
    """vision_msgs/Detection3DArray: the box is `bbox`, its size along its own axes.

    Score and class are those of the hypothesis that scores highest. Where the array's header names
    no frame, that of the first detection counts.
    """
    detections = message.detections
    frame_id = message.header.frame_id
    if not frame_id and len(detections):
        frame_id = detections[0].header.frame_id
    best = [_best_hypothesis(detection.results) for detection in detections]
    return DetectionMessage(
        stamp_ns=stamp_ns(message.header.stamp),
        frame_id=frame_id,
        boxes=_boxes([_pose_and_size(detection.bbox) for detection in detections]),
        scores=np.array([score for score, _ in best], dtype=np.float64),
        class_names=[name for _, name in best],
    )


def _best_hypothesis(results: Any) -> tuple[float, str]:
    hypotheses = [(result.hypothesis.score, result.hypothesis.class_id) for result in results]
    return max(hypotheses, key=lambda hypothesis: hypothesis[0], default=(float("nan"), ""))


def _pose_and_size(bbox: Any) -> tuple[float, ...]:
    centre, q, size = bbox.center.position, bbox.center.orientation, bbox.size
    return (centre.x, centre.y, centre.z, size.x, size.y, size.z, q.x, q.y, q.z, q.w)


def _boxes(rows: list[tuple[float, ...]]) -> FloatArray:
    values = np.array(rows, dtype=np.float64).reshape(-1, 10)
    return np.column_stack([values[:, :6], quaternion_yaw(values[:, 6:])])
