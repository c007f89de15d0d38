"""The numbers are KITTI's own: the same as TrackEval's from text files, to the last bit."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import trackeval

from hbbatch.errors import DatasetError
from hbbatch.evaluation.kitti import evaluate_kitti, kitti_tracks, kitti_truth
from hbbatch.evaluation.kitti_results import read_kitti_results
from hbbatch.evaluation.results import Scores
from hbbatch.projection import Camera
from tests.evaluation.kitti_text import fake_results, labels_table

SEQUENCES = ("0000", "0004", "0011", "0017")


@pytest.fixture(scope="module")
def label_files(test_data: Path) -> dict[str, Path]:
    folder = test_data / "kitti" / "training" / "label_02"
    return {name: folder / f"{name}.txt" for name in SEQUENCES}


@pytest.fixture(scope="module")
def result_files(
    label_files: dict[str, Path], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("tracker") / "data"
    folder.mkdir()
    rng = np.random.default_rng(5)
    for name, path in label_files.items():
        # Sequence 0011 was tracked and nothing was found: zero bytes.
        text = "" if name == "0011" else fake_results(path, rng)
        (folder / f"{name}.txt").write_text(text)
    return {name: folder / f"{name}.txt" for name in label_files}


@pytest.fixture(scope="module")
def stock(
    label_files: dict[str, Path],
    result_files: dict[str, Path],
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, Any]:
    """What TrackEval's own evaluator makes of the files, by sequence, class and metric."""
    truth = tmp_path_factory.mktemp("truth")
    (truth / "label_02").mkdir()
    seqmap = []
    for name, path in label_files.items():
        (truth / "label_02" / path.name).write_text(path.read_text())
        frames = max(int(line.split()[0]) for line in path.read_text().splitlines()) + 1
        seqmap.append(f"{name} empty 000000 {frames:06d}\n")
    (truth / "evaluate_tracking.seqmap.training").write_text("".join(seqmap))
    tracker = next(iter(result_files.values())).parent.parent
    dataset = trackeval.datasets.Kitti2DBox(
        {
            "GT_FOLDER": str(truth),
            "TRACKERS_FOLDER": str(tracker.parent),
            "TRACKERS_TO_EVAL": [tracker.name],
            "PRINT_CONFIG": False,
        }
    )
    quiet = {"PRINT_CONFIG": False}
    metrics = [trackeval.metrics.HOTA(), trackeval.metrics.CLEAR(quiet)]
    metrics.append(trackeval.metrics.Identity(quiet))
    config = dict.fromkeys(trackeval.Evaluator.get_default_eval_config(), False)
    with contextlib.redirect_stdout(io.StringIO()):
        evaluator = trackeval.Evaluator({**config, "BREAK_ON_ERROR": True, "LOG_ON_ERROR": None})
        results, _ = evaluator.evaluate([dataset], metrics)
    return results["Kitti2DBox"][tracker.name]


def as_scores(result: dict[str, Any]) -> Scores:
    hota, clear, count = result["HOTA"], result["CLEAR"], result["Count"]
    return Scores(
        hota=100 * float(np.mean(hota["HOTA"])),
        deta=100 * float(np.mean(hota["DetA"])),
        assa=100 * float(np.mean(hota["AssA"])),
        loca=100 * float(np.mean(hota["LocA"])),
        mota=100 * float(clear["MOTA"]),
        idf1=100 * float(result["Identity"]["IDF1"]),
        idsw=clear["IDSW"],
        frag=clear["Frag"],
        fp=clear["CLR_FP"],
        fn=clear["CLR_FN"],
        labelled_boxes=count["GT_Dets"],
        labelled_objects=count["GT_IDs"],
        tracked_boxes=count["Dets"],
        tracks=count["IDs"],
    )


def test_scores_equal_trackevals_from_files(
    label_files: dict[str, Path], result_files: dict[str, Path], stock: dict[str, Any]
) -> None:
    truth = kitti_truth({name: labels_table(path) for name, path in label_files.items()})
    evaluation = evaluate_kitti(truth, read_kitti_results(result_files))

    assert evaluation.protocol == "kitti_2d"
    for name in ("car", "pedestrian"):
        assert evaluation.classes[name].combined == as_scores(stock["COMBINED_SEQ"][name])
        assert 20 < evaluation.classes[name].combined.hota < 80
        for sequence_id, scores in evaluation.classes[name].sequences.items():
            assert scores == as_scores(stock[sequence_id][name])


def test_cyclists_are_evaluated_like_pedestrians(
    label_files: dict[str, Path], result_files: dict[str, Path]
) -> None:
    """Swapping the two class names in labels and results swaps the scores."""
    labels = {"0000": labels_table(label_files["0000"])}
    results = {"0000": result_files["0000"]}
    swap = {"Cyclist": "Pedestrian", "Pedestrian": "Cyclist"}
    names = [swap.get(name, name) for name in labels["0000"]["class_name_logged"].to_pylist()]
    index = labels["0000"].schema.get_field_index("class_name_logged")
    swapped = {"0000": labels["0000"].set_column(index, "class_name_logged", pa.array(names))}

    tracks = read_kitti_results(results)
    as_logged = evaluate_kitti(kitti_truth(labels, ["cyclist"]), tracks).classes["cyclist"]
    as_pedestrians = evaluate_kitti(
        kitti_truth(swapped, ["pedestrian"]), {"pedestrian": tracks["cyclist"]}
    ).classes["pedestrian"]

    assert as_logged.combined.labelled_boxes > 100
    assert as_logged == as_pedestrians


def tracks_table(boxes: np.ndarray) -> pa.Table:
    """One car, a box a frame, in the sensor frame."""
    fields = ("x", "y", "z", "length", "width", "height", "yaw")
    count = len(boxes)
    return pa.table(
        {
            "frame_index": np.arange(count),
            "track_id": np.ones(count, int),
            "class_name": ["car"] * count,
            "track_score": np.full(count, 0.5),
            **{f"sensor_{name}": boxes[:, i] for i, name in enumerate(fields)},
        }
    )


def test_tracks_are_projected_and_those_out_of_the_image_left_out() -> None:
    image_from_sensor = np.array(
        [[500.0, -700.0, 0.0, 0.0], [200.0, 0.0, -700.0, 0.0], [1.0, 0.0, 0.0, 0.0]]
    )
    ahead, behind = [20.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0], [-20.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0]
    table = tracks_table(np.array([ahead, behind]))

    tracks = kitti_tracks({"a": table}, {"a": Camera(image_from_sensor, 1000.0, 400.0)})["car"]["a"]

    assert tracks.frame_index.tolist() == [0]
    near_face_px = 700 * 1.0 / 18.0
    np.testing.assert_allclose(tracks.boxes[0, [0, 2]], [500 - near_face_px, 500 + near_face_px])


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("0 1 Car -1 -1 0 1 2 3 4\n", "line 1: not a KITTI tracking result"),
        (f"0 1 Car{' 0' * 15}\n\n", "line 2: not a KITTI tracking result"),
        (f"0 1 Car{' 0' * 15}\n0 1 Car{' x' * 15}\n", "line 2: not a KITTI tracking result"),
        (f"0 1 Car{' 0' * 15}\n0 1 Car{' 0' * 15}\n", "track 1 has two boxes in frame 0"),
    ],
)
def test_a_damaged_result_file_is_one_clear_error(tmp_path: Path, text: str, fault: str) -> None:
    path = tmp_path / "0000.txt"
    path.write_text(text)
    with pytest.raises(DatasetError, match=fault):
        read_kitti_results({"0000": path})
