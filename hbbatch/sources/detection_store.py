"""The detections of one topic, kept out of memory until they are put in the order of their stamps.

A message costs 40 bytes of memory; its boxes go to a temporary file once there are many.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import BOX_SIZE, LARGEST, FloatArray, are_boxes
from hbbatch.sources.base import (
    Findings,
    FrameBatch,
    IntArray,
    Names,
    Poses,
    no_image_boxes,
)
from hbbatch.sources.columns import DetectionColumns
from hbbatch.sources.spool import Spool
from hbbatch.sources.transforms import frame_name

_SCORE_WHEN_MISSING: Final = 1.0
_SCORE, _CLASS, _COLUMNS = 7, 8, 9
BATCH_ROWS: Final = 50_000
"""Frames and boxes of a batch that is written at once."""

_CLOCK_NS: Final = 60 * 1_000_000_000


def _usable(rows: FloatArray) -> NDArray[np.bool_]:
    """Which columns of `_COLUMNS` rows hold a box with a score, `(n,)`."""
    scored: NDArray[np.bool_] = np.isfinite(rows[_SCORE])
    return scored & are_boxes(rows[:BOX_SIZE].T)


class _Vocabulary:
    """Names met so far, numbered."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def codes(self, names: Names) -> IntArray:
        table = [self._numbers.setdefault(n, len(self._numbers)) for n in names.vocabulary]
        return np.array(table or [0], dtype=np.int64)[names.codes]

    def names(self, codes: IntArray) -> Names:
        return Names(codes, tuple(self._numbers))


@dataclass
class _PerMessage:
    """A column each, an entry a message."""

    stamp_ns: array[int]
    log_time_ns: array[int]
    number: array[int]
    frame: array[int]
    boxes: array[int]

    @classmethod
    def empty(cls) -> _PerMessage:
        return cls(*(array("q") for _ in range(5)))


def _view(column: array[int]) -> IntArray:
    """A column as an array, not copied; the column must not grow while it is in use."""
    return np.frombuffer(column, dtype=np.int64) if len(column) else np.zeros(0, dtype=np.int64)


class DetectionStore:
    """Detections as they are read, then in time order."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._messages = _PerMessage.empty()
        self._frames, self._classes = _Vocabulary(), _Vocabulary()
        self._rows = Spool(_COLUMNS)
        self._unusable: Counter[int] = Counter()
        self._unscored = self._unstamped = self._foreign = self._unsure_yaws = 0

    def __len__(self) -> int:
        return len(self._messages.stamp_ns)

    def add(self, columns: DetectionColumns, numbers: IntArray, log_time_ns: IntArray) -> None:
        """Keep the usable boxes of a batch of messages.

        Args:
            columns: the messages.
            numbers: `(m,)` which message of the topic each is, from 0.
            log_time_ns: `(m,)` when the recorder received them.
        """
        rows = np.empty((_COLUMNS, len(columns.boxes)))
        rows[:_SCORE] = columns.boxes.T
        unscored = np.isnan(columns.scores)
        rows[_SCORE] = columns.scores
        rows[_SCORE, unscored] = _SCORE_WHEN_MISSING
        rows[_CLASS] = self._classes.codes(columns.class_names)
        kept = columns.box_counts
        if not (usable := _usable(rows)).all():
            rows, kept = self._only(usable, rows, columns.box_counts, numbers)
        self._rows.append(rows)
        self._unscored += int(unscored.sum())
        self._unstamped += int((columns.stamp_ns == 0).sum())
        self._foreign += columns.foreign
        self._unsure_yaws += columns.unsure_yaws
        stamps_ns = np.where(columns.stamp_ns == 0, log_time_ns, columns.stamp_ns)
        frames = self._frames.codes(columns.frame_ids)
        into = self._messages
        for column, values in (
            (into.stamp_ns, stamps_ns),
            (into.log_time_ns, log_time_ns),
            (into.number, numbers),
            (into.frame, frames),
            (into.boxes, kept),
        ):
            column.frombytes(np.ascontiguousarray(values, dtype=np.int64).tobytes())

    def _only(
        self,
        usable: NDArray[np.bool_],
        rows: FloatArray,
        counts: IntArray,
        numbers: IntArray,
    ) -> tuple[FloatArray, IntArray]:
        """The usable rows, and how many of them each message has."""
        of_message = np.repeat(np.arange(len(counts)), counts)
        for message in of_message[~usable].tolist():
            self._unusable[int(numbers[message])] += 1
        return rows[:, usable], np.bincount(of_message[usable], minlength=len(counts))

    @property
    def boxes(self) -> int:
        """Usable boxes."""
        return sum(self._messages.boxes)

    def report(self, findings: Findings) -> None:
        """Write down what was lost and what was odd in the messages taken."""
        topic = f"topic {self._topic}"
        if self._unusable:
            findings.lost(
                f"{topic}: {self._unusable.total()} boxes left out, first in message "
                f"{min(self._unusable)}: not a number, a size that "
                f"is not greater than zero, or a value of more than {LARGEST:g}"
            )
        if self._foreign:
            findings.lost(
                f"{topic}: {self._foreign} boxes left out, in another frame than their message"
            )
        if self._unscored:
            findings.note(f"{topic}: {self._unscored} boxes without score, taken as 1")
        if self._unsure_yaws:
            findings.note(f"{topic}: {self._unsure_yaws} boxes of unknown or unsure heading")
        if self._unstamped:
            findings.note(f"{topic}: {self._unstamped} messages without stamp, log time taken")
        self._report_clock(findings, topic)

    def _report_clock(self, findings: Findings, topic: str) -> None:
        stamps_ns = _view(self._messages.stamp_ns)
        # Several writers of a topic are read apart from one another.
        in_file = np.argsort(_view(self._messages.number), kind="stable")
        backwards = int((np.diff(stamps_ns[in_file]) < 0).sum())
        if backwards:
            findings.note(f"{topic}: stamps run backwards {backwards} times, sorted")
        if not len(stamps_ns):
            return
        # As floats: a damaged stamp may be further off than 64 bits tell.
        offsets_ns = _view(self._messages.log_time_ns).astype(np.float64) - stamps_ns
        usual_ns = float(np.median(offsets_ns))
        if abs(usual_ns) > _CLOCK_NS:
            findings.note(
                f"{topic}: stamps and log times differ by {usual_ns / 1e9:.0f} s: two clocks; "
                f"the stamps of {len(stamps_ns)} messages count"
            )
        mixed = int((np.abs(offsets_ns - usual_ns) > _CLOCK_NS).sum())
        if mixed:
            findings.note(
                f"{topic}: mixed clocks: {mixed} of {len(stamps_ns)} messages are stamped by "
                "another clock than the others"
            )

    def order(self) -> tuple[IntArray, IntArray]:
        """Messages by stamp (equal stamps as in the file), and their stamps in that order."""
        stamps_ns = _view(self._messages.stamp_ns)
        order = np.lexsort((_view(self._messages.number), stamps_ns))
        return order, stamps_ns[order]

    def frame_ids(self, order: IntArray) -> Names:
        """Frames of messages, without leading slash; several spellings become one."""
        codes = _view(self._messages.frame)[order]
        spelled = self._frames.names(codes).vocabulary
        return Names.of([frame_name(frame) for frame in spelled])[codes]

    def batches(self, order: IntArray, frame_ids: Names, poses: Poses) -> Iterator[FrameBatch]:
        """Frames of messages in the given order, each with its frame and pose."""
        counts = _view(self._messages.boxes)
        starts = np.cumsum(counts) - counts
        weight = np.cumsum(counts[order] + 1)
        first = 0
        while first < len(order):
            limit = (weight[first - 1] if first else 0) + BATCH_ROWS
            last = max(int(np.searchsorted(weight, limit, side="right")), first + 1)
            part = slice(first, last)
            yield self._batch(order[part], starts, counts, frame_ids[part], poses[part])
            first = last

    def _batch(
        self, rows: IntArray, starts: IntArray, counts: IntArray, frames: Names, poses: Poses
    ) -> FrameBatch:
        values = self._rows.read(starts[rows], counts[rows])
        numbers = _view(self._messages.number)[rows]
        return FrameBatch(
            timestamp_ns=_view(self._messages.stamp_ns)[rows],
            log_time_ns=_view(self._messages.log_time_ns)[rows],
            frame_ids=frames,
            poses=poses,
            box_counts=counts[rows],
            boxes=values[:_SCORE].T,
            scores=values[_SCORE],
            class_names=self._classes.names(values[_CLASS].astype(np.int64)),
            image_boxes=no_image_boxes(values.shape[1]),
            source_rows=np.repeat(numbers, counts[rows]),
        )
