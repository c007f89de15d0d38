"""Where the time of an ingest goes: the functions that make up each part, timed from outside.

A part is what its functions take by themselves, without the parts they call.
"""

from __future__ import annotations

import functools
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

import pyarrow.parquet as pq

from hbbatch.dataset import atomic
from hbbatch.runner import ingest_tables
from hbbatch.sources import batched, log, log_poses, log_scan, mcap, mcap_records
from hbbatch.sources.blocks import BlockBuilder
from hbbatch.sources.cdr_walk import CdrWalk
from hbbatch.sources.detection_store import DetectionStore

REST: Final = "catalogue and all else"
_PARTS: Final[dict[str, tuple[tuple[Any, str], ...]]] = {
    "hash of the file": ((mcap, "file_hash"),),
    "reading, checksum of the file, finding records": ((mcap, "runs"),),
    "unpacking chunks": ((mcap_records, "_decompress"),),
    "checksums of chunks": ((mcap_records, "_unpacked"),),
    "heads of messages, wanted ones into the buffer": (
        (mcap._Table, "take"),
        (BlockBuilder, "add"),
    ),
    "definitions": ((batched, "layout"),),
    "walk of the CDR bytes": ((CdrWalk, "read"),),
    "boxes, yaws, best hypotheses": ((log_scan.LogScan, "_read"),),
    "keeping boxes, putting them in order": ((DetectionStore, "add"), (DetectionStore, "_batch")),
    "transforms and poses": (
        (log_poses.PoseMessages, "add_transforms"),
        (log, "_frame_poses"),
        (ingest_tables, "jumps_problem"),
    ),
    "tables": ((ingest_tables, "detections_table"), (ingest_tables, "poses_table")),
    "hash of the content": ((ingest_tables.ContentHash, "add"),),
    "Parquet, to disk": (
        (pq.ParquetWriter, "write_table"),
        (pq.ParquetWriter, "close"),
        (atomic, "_flush"),
    ),
}


class _Clock:
    """Seconds of CPU by part; time of a part within another counts for the inner one."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._inner: list[float] = []

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        started = time.process_time()
        self._inner.append(0.0)
        try:
            yield
        finally:
            taken = time.process_time() - started
            self.seconds[name] += taken - self._inner.pop()
            if self._inner:
                self._inner[-1] += taken

    def timed(self, name: str, work: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(work)
        def run(*args: Any, **options: Any) -> Any:
            with self.part(name):
                result = work(*args, **options)
            return self._drawn(name, result) if isinstance(result, Iterator) else result

        return run

    def _drawn(self, name: str, items: Iterator[Any]) -> Iterator[Any]:
        done = object()
        while True:
            with self.part(name):
                item = next(items, done)
            if item is done:
                return
            yield item


def split(work: Callable[[], Any]) -> dict[str, float]:
    """Seconds of CPU of each part of an ingest; changes the functions of this process for good."""
    clock = _Clock()
    for name, functions in _PARTS.items():
        for owner, function in functions:
            setattr(owner, function, clock.timed(name, getattr(owner, function)))
    with clock.part(REST):
        work()
    return dict(clock.seconds)
