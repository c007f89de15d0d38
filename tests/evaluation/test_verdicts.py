"""Which boxes are right: held against TrackEval's counts on real labels, and by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from hbbatch.boxes import BOX_FIELDS
from hbbatch.evaluation.kitti import evaluate_kitti, kitti_tracks, kitti_truth
from hbbatch.evaluation.verdicts import NOT_JUDGED, RIGHT, WRONG, image_iou, verdicts
from hbbatch.projection import Camera
from tests.tracking.real_drives import real_dataset


def detections_as_tracks(detections: pa.Table, least_score: float) -> pa.Table:
    """Every detection as a track of its own."""
    kept = detections.filter(pa.array(detections["score"].to_numpy() >= least_score))
    columns = {
        "frame_index": kept["frame_index"],
        "track_id": np.arange(kept.num_rows),
        "class_name": kept["class_name"],
        "track_score": kept["score"],
    }
    return pa.table(columns | {f"sensor_{name}": kept[name] for name in BOX_FIELDS})


@pytest.mark.parametrize("name", ["car", "pedestrian"])
@pytest.mark.parametrize("sequence_id", ["0000", "0004", "0011", "0017"])
def test_right_and_wrong_boxes_are_as_many_as_trackeval_counts(
    test_data: Path, name: str, sequence_id: str
) -> None:
    detector = "virconv" if name == "car" else "pointrcnn"
    dataset = real_dataset(test_data, detector)
    labels, calibration = dataset.labels(sequence_id), dataset.calibration(sequence_id)
    assert labels is not None
    assert calibration is not None
    camera = Camera.from_calibration(calibration, sequence_id)
    table = detections_as_tracks(dataset.detections(sequence_id), 1.0)
    found = verdicts(table, labels, camera, name)
    truth = kitti_truth({sequence_id: labels}, [name])
    tracks = kitti_tracks({sequence_id: table}, {sequence_id: camera}, [name])
    scores = evaluate_kitti(truth, tracks).classes[name].combined
    # TrackEval matches across ignored objects by other rules; both see nearly the same boxes.
    assert (found == RIGHT).sum() == pytest.approx(
        scores.labelled_boxes - scores.fn, rel=0.02, abs=2
    )
    assert (found == WRONG).sum() == pytest.approx(scores.fp, rel=0.1, abs=5)


def labelled(rows: list[tuple[int, str, list[float]]]) -> pa.Table:
    """Labels without image boxes, from (frame, class, box)."""
    frame, names, boxes = zip(*rows, strict=True)
    columns = {
        "frame_index": pa.array(frame, pa.int32()),
        "object_id": np.arange(len(rows)),
        "class_name": names,
        "class_name_logged": names,
        "image_left": pa.nulls(len(rows), pa.float64()),
        "truncation": np.full(len(rows), -1.0),
        "occlusion": np.full(len(rows), -1),
    }
    return pa.table(columns | _boxes("", boxes))


def tracked(rows: list[tuple[int, str, list[float]]]) -> pa.Table:
    frame, names, boxes = zip(*rows, strict=True)
    columns = {"frame_index": pa.array(frame, pa.int32()), "class_name": names}
    return pa.table(columns | _boxes("sensor_", boxes))


def _boxes(prefix: str, boxes: tuple[list[float], ...]) -> dict[str, np.ndarray]:
    values = np.array(boxes)
    return {f"{prefix}{name}": values[:, i] for i, name in enumerate(BOX_FIELDS)}


def car(x: float) -> list[float]:
    return [x, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0]


def test_without_a_camera_volumes_decide_and_an_object_counts_once() -> None:
    labels = labelled([(0, "car", car(0.0)), (1, "car", car(5.0)), (1, "bus", car(30.0))])
    tracks = tracked(
        [
            (0, "car", car(0.4)),
            (0, "car", car(0.8)),
            (1, "car", car(50.0)),
            (1, "bus", car(30.0)),
            (2, "car", car(0.0)),
        ]
    )
    expected = [RIGHT, WRONG, WRONG, NOT_JUDGED, WRONG]
    assert verdicts(tracks, labels, None, "car").tolist() == expected
    assert verdicts(tracks, labels, None, "bus").tolist() == [-1, -1, -1, RIGHT, -1]


def test_overlap_of_rectangles() -> None:
    first = np.array([[0.0, 0, 4, 2], [10, 10, 11, 11]])
    second = np.array([[2.0, 1, 4, 3], [0, 0, 4, 2]])
    assert image_iou(first, second) == pytest.approx(np.array([[2 / 10, 1.0], [0.0, 0.0]]))
