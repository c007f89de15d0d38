"""The tracker as a plain loop: one sequence at a time, one track at a time.

What the lock step is measured against, in results (tests) and in speed (`hbbatch bench`). It walks
the paper's algorithm with the filter's torch modules; damping and classes of one kind are left
out, and so is what refining does afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from hbbatch.boxes import FloatArray
from hbbatch.config import TrackSettings
from hbbatch.model.filters import Measurement, MotionFilter
from hbbatch.tracking.costs import COSTS, shapes_of
from hbbatch.tracking.frames import IntArray, SequenceFrames
from hbbatch.tracking.schedule import intervals


@dataclass
class _Track:
    kind: int
    boxes: Tensor
    state: Tensor
    hits: int = 1
    misses: int = 0
    said: dict[int, FloatArray] = field(default_factory=dict)


@torch.inference_mode()
def track_plainly(
    frames: SequenceFrames, motion: MotionFilter, kind_of_class: IntArray, settings: TrackSettings
) -> list[dict[int, FloatArray]]:
    """Boxes `(7,)` of each track's detected frames, by frame index; tracks in order of birth."""
    live: list[_Track] = []
    everyone: list[_Track] = []
    for frame, dt in enumerate(intervals(frames)):
        rows = np.arange(frames.offsets[frame], frames.offsets[frame + 1])
        for track in live:
            step = torch.tensor([dt], dtype=torch.float32)
            track.boxes, track.state = motion.predict(track.boxes, track.state, step)
            track.misses += 1
        kinds = kind_of_class[frames.class_codes[rows]]
        matched = _matches(live, frames.boxes[rows], kinds, settings)
        for number, row in enumerate(rows):
            seen = _measurement(frames, row)
            if number in matched:
                track = matched[number]
                track.boxes, track.state = motion.update(track.boxes, track.state, seen)
                track.hits, track.misses = track.hits + 1, 0
            else:
                state = motion.birth(seen, torch.tensor([kinds[number]]))
                track = _Track(int(kinds[number]), seen.boxes, state)
                live.append(track)
                everyone.append(track)
            track.said[frame] = track.boxes[0].numpy().copy()
        live = [track for track in live if _lives(track, settings)]
    return [track.said for track in everyone]


def _matches(
    live: list[_Track], detections: FloatArray, kinds: IntArray, settings: TrackSettings
) -> dict[int, _Track]:
    """Detection number → track: the cheapest pair of the full matrix, again and again."""
    matched: dict[int, _Track] = {}
    if not live or not len(detections):
        return matched
    priors = np.concatenate([track.boxes.numpy() for track in live])
    first, second = (index.ravel() for index in np.indices((len(live), len(detections))))
    shapes = shapes_of(priors[first]), shapes_of(detections[second])
    cost = COSTS[settings.association.cost](*shapes)
    cost = cost.reshape(len(live), len(detections))
    cost[np.array([track.kind for track in live])[:, None] != kinds] = np.inf
    while cost.min() < settings.association.threshold:
        track, detection = np.unravel_index(cost.argmin(), cost.shape)
        matched[int(detection)] = live[int(track)]
        cost[track, :] = cost[:, detection] = np.inf
    return matched


def _measurement(frames: SequenceFrames, row: int) -> Measurement:
    return Measurement(
        torch.tensor(frames.boxes[[row]]),
        torch.tensor(frames.sight_m[[row]], dtype=torch.float32),
        torch.tensor(frames.scores[[row]], dtype=torch.float32),
    )


def _lives(track: _Track, settings: TrackSettings) -> bool:
    limits = settings.management
    return track.misses < (limits.max_misses if track.hits > 1 else limits.max_misses_unconfirmed)
