"""Frames of a reading one by one, as tests look at them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from hbbatch.boxes import FloatArray
from hbbatch.sources.base import FrameBatch, IntArray, SequenceReading


@dataclass(frozen=True)
class Pose:
    translation_m: FloatArray
    rotation: FloatArray
    origin: str


@dataclass(frozen=True)
class Frame:
    timestamp_ns: int
    log_time_ns: int | None
    frame_id: str
    pose: Pose
    boxes: FloatArray
    scores: FloatArray
    class_names: list[str]
    image_boxes: FloatArray
    source_rows: IntArray


def frames_of(reading: SequenceReading) -> list[Frame]:
    return [frame for batch in reading.batches for frame in _frames(batch)]


def _frames(batch: FrameBatch) -> Iterator[Frame]:
    names = batch.class_names.to_list()
    frame_ids, origins = batch.frame_ids.to_list(), batch.poses.origins.to_list()
    start = 0
    for index, count in enumerate(batch.box_counts.tolist()):
        rows = slice(start, start + count)
        start += count
        log_time_ns = None if batch.log_time_ns is None else int(batch.log_time_ns[index])
        pose = Pose(batch.poses.translation_m[index], batch.poses.rotation[index], origins[index])
        yield Frame(
            int(batch.timestamp_ns[index]),
            log_time_ns,
            frame_ids[index],
            pose,
            batch.boxes[rows],
            batch.scores[rows],
            names[rows],
            batch.image_boxes[rows],
            batch.source_rows[rows],
        )
    assert start == len(batch.boxes)
