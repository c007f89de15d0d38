"""Sequences cut where no track can be alive, tracked in pieces side by side, and joined again.

A lock step takes as many steps as its longest sequence has frames. After so many frames without a
detection that every track is dead, what follows does not depend on what was before: it can be
stepped at the same time. Frames without detections and without tracks are not stepped at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hbbatch.config import ManagementSettings
from hbbatch.tracking.frames import IntArray, SequenceFrames
from hbbatch.tracking.tracks import SequenceTracks, StageSeconds

Done = tuple[int, SequenceTracks, StageSeconds]
"""Number of a sequence (or piece), its boxes, its share of the time."""


@dataclass(frozen=True)
class Piece:
    """Frames of a sequence that can be tracked by themselves.

    Attributes:
        sequence: its number in the group.
        first_frame: where the piece begins.
        first_row: detections of the sequence before it.
        frames: the piece.
    """

    sequence: int
    first_frame: int
    first_row: int
    frames: SequenceFrames


def cut(group: Sequence[SequenceFrames], management: ManagementSettings) -> list[Piece]:
    """Pieces of all sequences of a group, at least one (perhaps without frames) a sequence."""
    patience = max(management.max_misses, management.max_misses_unconfirmed)
    return [
        Piece(number, first, int(frames.offsets[first]), frames.part(first, stop))
        for number, frames in enumerate(group)
        for first, stop in _stretches(frames.offsets, patience)
    ]


def _stretches(offsets: IntArray, patience: int) -> list[tuple[int, int]]:
    """First frames of pieces and the frames after their last, when all tracks have died."""
    (busy,) = np.diff(offsets).nonzero()
    if not len(busy):
        return [(0, 0)]
    (quiet,) = (np.diff(busy) > patience).nonzero()
    firsts, lasts = busy[[0, *(quiet + 1)]], busy[[*quiet, -1]]
    stops = np.minimum(lasts + patience + 1, len(offsets) - 1)
    return list(zip(firsts.tolist(), stops.tolist(), strict=True))


def joined(pieces: Sequence[Piece], done: Iterable[Done]) -> Iterator[Done]:
    """Sequences as their last piece is done.

    Args:
        pieces: of all sequences, those of a sequence in order.
        done: tracked pieces, by number and in any order.
    """
    missing = [0] * (1 + max((piece.sequence for piece in pieces), default=-1))
    for piece in pieces:
        missing[piece.sequence] += 1
    parts: dict[int, dict[int, Done]] = {}
    for part in done:
        sequence = pieces[part[0]].sequence
        of_sequence = parts.setdefault(sequence, {})
        of_sequence[part[0]] = part
        if len(of_sequence) == missing[sequence]:
            in_order = [of_sequence[number] for number in sorted(of_sequence)]
            tracks = _join([(pieces[number], tracks) for number, tracks, _ in in_order])
            yield sequence, tracks, StageSeconds.total(seconds for _, _, seconds in in_order)
            del parts[sequence]


def _join(parts: Sequence[tuple[Piece, SequenceTracks]]) -> SequenceTracks:
    """Tracks of pieces in the frames and rows of their sequence; identities go on counting."""
    moved, identities = [], 0
    for piece, tracks in parts:
        row = tracks.detection_row
        moved.append(
            replace(
                tracks,
                frame_index=tracks.frame_index + piece.first_frame,
                track_id=tracks.track_id + identities,
                detection_row=np.where(row >= 0, row + piece.first_row, row),
            )
        )
        identities += int(tracks.track_id.max(initial=0))
    columns = zip(*(vars(tracks).values() for tracks in moved), strict=True)
    return SequenceTracks(*(np.concatenate(column) for column in columns))
