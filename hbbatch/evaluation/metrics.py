"""TrackEval's metrics and KITTI preprocessing, called on boxes in memory.

TrackEval reads text files; evaluating from tables instead spares the parsing, which is most of its
time, and leaves the numbers alone: everything that decides them (matching, preprocessing, metrics)
is TrackEval's own code. Source: J. Luiten, A. Hoffhues, TrackEval 1.3.0 (MIT).
"""

from __future__ import annotations

import contextlib
import functools
import io
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hbbatch.boxes import FloatArray
from hbbatch.errors import MissingExtraError, SequenceError
from hbbatch.evaluation.results import ClassScores, Scores

IntArray = NDArray[np.int64]

# TrackEval preprocesses two classes only. The one without labelled look-alikes in our data carries
# the others: an evaluated object is a "pedestrian", a look-alike to be ignored is a "person".
_EVALUATED: Final = "pedestrian"
_LOOK_ALIKE: Final = "person"


@dataclass(frozen=True)
class ClassTruth:
    """Labels of one class in one sequence, one row a box, sorted by frame.

    Attributes:
        frame_index: `(n,)`.
        object_id: `(n,)`, unique within a frame.
        boxes: `(n, k)` image or 3D boxes.
        look_alike: `(n,)` true for objects that may be tracked or not (a van for cars).
        occlusion: `(n,)` KITTI level; above 2 the object may be tracked or not.
        truncation: `(n,)` KITTI level; above 0 the object may be tracked or not.
        ignored_frame_index: `(m,)` frame of each ignored region.
        ignored_regions: `(m, k)` boxes like the labels; tracks mostly inside one are not counted.
    """

    frame_index: IntArray
    object_id: IntArray
    boxes: FloatArray
    look_alike: NDArray[np.bool_]
    occlusion: IntArray
    truncation: IntArray
    ignored_frame_index: IntArray
    ignored_regions: FloatArray


@dataclass(frozen=True)
class ClassTracks:
    """Tracks of one class in one sequence, one row a box, sorted by frame.

    Attributes:
        frame_index: `(n,)`.
        track_id: `(n,)`, unique within a frame.
        boxes: `(n, k)` image or 3D boxes.
        track_score: `(n,)` mean detection score of the box's track.
    """

    frame_index: IntArray
    track_id: IntArray
    boxes: FloatArray
    track_score: FloatArray

    def take(self, rows: NDArray[np.generic]) -> ClassTracks:
        """Rows chosen by a mask or by index."""
        return ClassTracks(**{name: column[rows] for name, column in vars(self).items()})


@dataclass(frozen=True)
class _Metrics:
    hota: Any
    clear: Any
    identity: Any
    count: Any


def score_class(
    truth: dict[str, ClassTruth],
    tracks: dict[str, ClassTracks],
    dataset: Any,
) -> ClassScores:
    """Scores of one class on each sequence and on all together.

    Args:
        truth: labels by sequence id.
        tracks: tracks by sequence id; a sequence of `truth` that is absent has none.
        dataset: `kitti_dataset()` or a variant of it: similarity and preprocessing.

    Raises:
        SequenceError: two boxes of a frame carry the same identity.
        MissingExtraError: TrackEval is not installed.
    """
    metrics = _metrics()
    results = {
        sequence_id: _score_sequence(sequence_id, labels, tracks.get(sequence_id), dataset)
        for sequence_id, labels in sorted(truth.items())
    }
    combined = {
        name: metric.combine_sequences({s: r[name] for s, r in results.items()})
        for name, metric in vars(metrics).items()
    }
    return ClassScores(_scores(combined), {s: _scores(r) for s, r in results.items()})


def _score_sequence(
    sequence_id: str, truth: ClassTruth, tracks: ClassTracks | None, dataset: Any
) -> dict[str, Any]:
    raw = _raw_data(sequence_id, truth, tracks or _no_tracks(truth.boxes.shape[1]), dataset)
    exception = _trackeval().utils.TrackEvalException
    try:
        data = dataset.get_preprocessed_seq_data(raw, _EVALUATED)
    except exception as error:
        raise SequenceError(
            f"sequence {sequence_id}: {' '.join(str(error).split())}. "
            "Identities must be unique within a frame."
        ) from error
    return {name: metric.eval_sequence(data) for name, metric in vars(_metrics()).items()}


def _raw_data(
    sequence_id: str, truth: ClassTruth, tracks: ClassTracks, dataset: Any
) -> dict[str, Any]:
    """TrackEval's raw data: a list over frames for each column.

    Frames with neither labels nor tracks change no metric and are left out.
    """
    frames = np.union1d(truth.frame_index, tracks.frame_index)
    ids = dataset.class_name_to_class_id
    by_truth = functools.partial(_by_frame, truth.frame_index, frames)
    by_track = functools.partial(_by_frame, tracks.frame_index, frames)
    occlusion, truncation = by_truth(truth.occlusion), by_truth(truth.truncation)
    truth_boxes, track_boxes = by_truth(truth.boxes), by_track(tracks.boxes)
    return {
        "seq": sequence_id,
        "num_timesteps": len(frames),
        "gt_ids": by_truth(truth.object_id),
        "gt_classes": by_truth(np.where(truth.look_alike, ids[_LOOK_ALIKE], ids[_EVALUATED])),
        "gt_dets": truth_boxes,
        "gt_extras": [
            {"occlusion": o, "truncation": t} for o, t in zip(occlusion, truncation, strict=True)
        ],
        "gt_crowd_ignore_regions": _by_frame(
            truth.ignored_frame_index, frames, truth.ignored_regions
        ),
        "tracker_ids": by_track(tracks.track_id),
        "tracker_classes": by_track(np.full(len(tracks.track_id), ids[_EVALUATED])),
        "tracker_dets": track_boxes,
        "tracker_confidences": by_track(tracks.track_score),
        "similarity_scores": [
            dataset._calculate_similarities(a, b)
            for a, b in zip(truth_boxes, track_boxes, strict=True)
        ],
    }


def _by_frame(frame_index: IntArray, frames: IntArray, column: NDArray[Any]) -> list[NDArray[Any]]:
    starts = np.searchsorted(frame_index, frames)
    ends = np.searchsorted(frame_index, frames, side="right")
    return [column[start:end] for start, end in zip(starts, ends, strict=True)]


def _no_tracks(box_size: int) -> ClassTracks:
    none = np.empty(0, np.int64)
    return ClassTracks(none, none, np.empty((0, box_size)), np.empty(0))


def _scores(result: dict[str, Any]) -> Scores:
    hota, clear, count = result["hota"], result["clear"], result["count"]
    return Scores(
        **{name.lower(): _percent(hota[name]) for name in ("HOTA", "DetA", "AssA", "LocA")},
        mota=_percent(clear["MOTA"]),
        idf1=_percent(result["identity"]["IDF1"]),
        idsw=int(clear["IDSW"]),
        frag=int(clear["Frag"]),
        fp=int(clear["CLR_FP"]),
        fn=int(clear["CLR_FN"]),
        labelled_boxes=int(count["GT_Dets"]),
        labelled_objects=int(count["GT_IDs"]),
        tracked_boxes=int(count["Dets"]),
        tracks=int(count["IDs"]),
    )


def _percent(value: Any) -> float:
    return float(np.mean(value)) * 100.0


@functools.cache
def _trackeval() -> Any:
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            import trackeval
    except ImportError as error:
        raise MissingExtraError(
            "evaluation needs the package trackeval, which is not installed. "
            "Run: pip install 'hbbatch[eval]'"
        ) from error
    return trackeval


@functools.cache
def _metrics() -> _Metrics:
    metrics = _trackeval().metrics
    quiet = {"PRINT_CONFIG": False}
    return _Metrics(metrics.HOTA(), metrics.CLEAR(quiet), metrics.Identity(quiet), metrics.Count())


@functools.cache
def kitti_dataset() -> Any:
    """TrackEval's KITTI dataset with the official thresholds and no files.

    Its constructor insists on a list of sequences; one that names none lets it find nothing to do.
    """
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "evaluate_tracking.seqmap.training").write_text("none 0\nnone 0\n")
        config = {
            "GT_FOLDER": folder,
            "TRACKERS_FOLDER": folder,
            "TRACKERS_TO_EVAL": [],
            "PRINT_CONFIG": False,
        }
        return _trackeval().datasets.Kitti2DBox(config)
