"""KITTI folders: the layouts, the frames, and the lines that are refused."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hbbatch.boxes import FloatArray, corners, transform_boxes
from hbbatch.errors import SourceError
from hbbatch.sources.base import SequenceReading, SourceOptions
from hbbatch.sources.kitti import KittiSource
from tests.frames import Frame, frames_of
from tests.kitti_folders import CAR, calibration_text, oxts_text, write_sequence


def read(root: Path, detections: Path | None = None, sequence: int = 0) -> SequenceReading:
    [reading] = KittiSource(root, SourceOptions(detections)).sequences()[sequence].read()
    return reading


def frames(root: Path, detections: Path | None = None) -> list[Frame]:
    return frames_of(read(root, detections))


def test_box_is_moved_from_the_camera_to_a_frame_with_z_up(tmp_path: Path) -> None:
    line = "0 Car -1 -1 0.1 100 150 200 250 1.5 1.6 4.0 2.0 1.7 20.0 0.0 0.9"
    [frame] = frames(write_sequence(tmp_path, frames=1, detections=[line]))
    # Camera x is right, y down, z forward; ry = 0 heads along camera x, which is to the right.
    np.testing.assert_allclose(
        frame.boxes, [[20.0, -2.0, -1.7 + 0.75, 4.0, 1.6, 1.5, -np.pi / 2]], atol=1e-12
    )
    assert frame.frame_id == "camera0_rect_flu"
    assert frame.scores.tolist() == [0.9]
    assert list(frame.class_names) == ["Car"]
    np.testing.assert_array_equal(frame.image_boxes, [[100, 150, 200, 250]])


def test_frames_come_at_ten_hertz_and_empty_ones_are_kept(tmp_path: Path) -> None:
    read_frames = frames(write_sequence(tmp_path, frames=4, detections=[f"2 {CAR} 0.5"]))
    assert [frame.timestamp_ns for frame in read_frames] == [0, 10**8, 2 * 10**8, 3 * 10**8]
    assert [len(frame.boxes) for frame in read_frames] == [0, 0, 1, 0]


def test_world_is_the_imu_frame_of_the_first_record(tmp_path: Path) -> None:
    """The IMU looks along x; the camera sits 1.08 m ahead, 0.32 m right and 0.88 m above it."""
    first, second = frames(write_sequence(tmp_path, oxts=oxts_text(2, 3.0), frames=2))
    mounted_m = [0.81 + 0.27, -0.32, 0.8 - 0.08]
    np.testing.assert_allclose(first.pose.translation_m, mounted_m, atol=1e-9)
    np.testing.assert_allclose(second.pose.translation_m - mounted_m, [3.0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(np.abs(first.pose.rotation), [0, 0, 0, 1], atol=1e-12)
    assert first.pose.origin == "logged"


def test_world_is_level_with_the_first_record_whatever_its_heading(tmp_path: Path) -> None:
    _, second = frames(write_sequence(tmp_path, oxts=oxts_text(2, 3.0, yaw=0.7), frames=2))
    np.testing.assert_allclose(second.pose.translation_m[0], 3.0 + 1.08, atol=1e-6)


def test_layouts_give_the_same_frames(tmp_path: Path) -> None:
    rows = [(0, "Car", 0.9), (0, "Pedestrian", 0.2), (1, "Car", 0.8), (2, "Cyclist", -1.5)]
    shape = "100 150 200 250", "1.5 1.6 4.0 2.0 1.7 20.0 0.3"
    root = write_sequence(tmp_path / "source", detections=[])
    whole = tmp_path / "whole"
    split = tmp_path / "split" / "0000"
    csv = tmp_path / "csv"
    for folder in (whole, split, csv):
        folder.mkdir(parents=True)
    codes = {"Pedestrian": 1, "Car": 2, "Cyclist": 3}
    for frame, name, score in rows:
        _append(whole / "0000.txt", f"{frame} {name} -1 -1 0.1 {shape[0]} {shape[1]} {score}")
        _append(split / f"{frame:06d}.txt", f"{name} -1 -1 0.1 {shape[0]} {shape[1]} {score}")
        columns = [frame, codes[name], *shape[0].split(), score, *shape[1].split(), 0.1]
        _append(csv / "0000.txt", ",".join(str(value) for value in columns))
    expected = frames(root, whole)
    assert [len(frame.boxes) for frame in expected] == [2, 1, 1]
    for detections in (split.parent, csv):
        for one, other in zip(frames(root, detections), expected, strict=True):
            np.testing.assert_array_equal(one.boxes, other.boxes)
            np.testing.assert_array_equal(one.scores, other.scores)
            np.testing.assert_array_equal(one.image_boxes, other.image_boxes)
            assert list(one.class_names) == list(other.class_names)


def _append(path: Path, line: str) -> None:
    with path.open("a") as file:
        file.write(f"{line}\n")


@pytest.mark.parametrize("names", [("Car", "Pedestrian"), ("x_Car_val", "x_Pedestrian_val")])
def test_class_folders_are_joined(tmp_path: Path, names: tuple[str, str]) -> None:
    root = write_sequence(tmp_path / "source", detections=[])
    for name, kind in zip(names, ("Car", "Pedestrian"), strict=True):
        (tmp_path / "found" / name).mkdir(parents=True)
        _append(tmp_path / "found" / name / "0000.txt", f"1 {CAR.replace('Car', kind)} 0.5")
    _, second, _ = frames(root, tmp_path / "found")
    assert list(second.class_names) == ["Car", "Pedestrian"]


def test_two_folders_of_one_class_are_not_mixed(tmp_path: Path) -> None:
    root = write_sequence(tmp_path / "source")
    for name in ("a_Car_val", "a_Car_test"):
        (tmp_path / "found" / name).mkdir(parents=True)
        _append(tmp_path / "found" / name / "0000.txt", f"1 {CAR} 0.5")
    with pytest.raises(SourceError, match=r"sequence 0000: .*a_Car_test and .*both hold class car"):
        read(root, tmp_path / "found")


def test_image_box_that_spans_nothing_is_none(tmp_path: Path) -> None:
    line = f"0 {CAR} 0.9".replace("100 150 200 250", "-1 -1 -1 -1")
    [frame] = frames(write_sequence(tmp_path, frames=1, detections=[line]))
    assert np.isnan(frame.image_boxes).all()


def test_labels_have_identities_and_regions_to_ignore(tmp_path: Path) -> None:
    ignored = "1 -1 DontCare -1 -1 -10 5 5 9 9 -1000 -1000 -1000 -10 -1 -1 -1"
    reading = read(write_sequence(tmp_path, labels=f"{ignored}\n0 7 {CAR}\n"))
    assert reading.labels is not None
    assert reading.labels.frame_index.tolist() == [0, 1]
    assert reading.labels.object_id.tolist() == [7, -1]
    assert np.isfinite(reading.labels.boxes[0]).all()
    assert np.isnan(reading.labels.boxes[1]).all()
    np.testing.assert_array_equal(reading.labels.image_boxes[1], [5, 5, 9, 9])


def test_without_oxts_poses_are_identity_and_that_is_said(tmp_path: Path) -> None:
    root = write_sequence(tmp_path, frames=3)
    (root / "oxts" / "0000.txt").unlink()
    reading = read(root)
    assert [frame.pose.origin for frame in frames_of(reading)] == ["identity"] * 3
    [problem] = reading.findings.problems
    assert "oxts" in problem
    assert not reading.findings.partial


def test_camera_projects_where_kitti_says(tmp_path: Path) -> None:
    root = write_sequence(tmp_path)
    camera = read(root).calibration
    assert camera is not None
    assert (camera.image_width_px, camera.image_height_px) == (1242, 375)
    u, v, depth = camera.image_from_sensor @ [20.0, -2.0, -1.7, 1.0]
    assert u / depth == pytest.approx((721.5377 * 2 + 609.5593 * 20 + 44.85728) / 20.002745884)
    assert v / depth == pytest.approx((721.5377 * 1.7 + 172.854 * 20 + 0.2163791) / 20.002745884)


def test_image_size_is_read_from_images(tmp_path: Path) -> None:
    root = write_sequence(tmp_path)
    images = root / "image_02" / "0000"
    images.mkdir(parents=True)
    head = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", 640, 480)
    (images / "000000.png").write_bytes(head)
    camera = read(root).calibration
    assert camera is not None
    assert (camera.image_width_px, camera.image_height_px) == (640, 480)


def test_unknown_camera_takes_its_size_from_image_boxes_and_says_so(tmp_path: Path) -> None:
    other = calibration_text(P2="500 0 320 0 0 500 240 0 0 0 1 0")
    reading = read(write_sequence(tmp_path, calibration=other))
    assert reading.calibration is not None
    assert reading.calibration.image_width_px == 200
    assert any("image size unknown" in problem for problem in reading.findings.problems)


@pytest.mark.parametrize(
    ("velodyne", "imu", "rectified"),
    [("Tr_velo_cam", "Tr_imu_velo", "R_rect"), ("Tr_velo_to_cam", "Tr_imu_to_velo", "R0_rect")],
)
@pytest.mark.parametrize("colon", [":", ""])
def test_calibration_in_all_spellings(
    tmp_path: Path, velodyne: str, imu: str, rectified: str, colon: str
) -> None:
    text = calibration_text()
    expected = frames(write_sequence(tmp_path / "usual"))
    for usual, spelling in (
        ("Tr_velo_to_cam:", f"{velodyne}{colon}"),
        ("Tr_imu_to_velo:", f"{imu}{colon}"),
        ("R0_rect:", f"{rectified}{colon}"),
    ):
        text = text.replace(usual, spelling)
    other = frames(write_sequence(tmp_path / "other", calibration=text))
    for one, two in zip(expected, other, strict=True):
        np.testing.assert_array_equal(one.pose.translation_m, two.pose.translation_m)


BAD_LINES = {
    "too few columns": (f"1 {CAR}", "16 columns, expected 17"),
    "not a number": (f"1 {CAR} high", "'high' is not a number"),
    "NaN": (f"1 {CAR} nan", "nan is not a number"),
    "infinite": (f"1 {CAR.replace('20.0', 'inf')} 0.9", "inf is not a number"),
    "negative size": (f"1 {CAR.replace('1.6', '-1.6')} 0.9", "must be greater than zero"),
    "zero size": (f"1 {CAR.replace('1.6', '0')} 0.9", "must be greater than zero"),
    "half a frame": (f"1.5 {CAR} 0.9", "frame is not a whole number"),
    "negative frame": (f"-1 {CAR} 0.9", "frame is not a whole number"),
}


@pytest.mark.parametrize(("line", "expected"), BAD_LINES.values(), ids=BAD_LINES.keys())
def test_bad_detection_names_file_and_line(tmp_path: Path, line: str, expected: str) -> None:
    root = write_sequence(tmp_path, detections=[f"0 {CAR} 0.9", "", line])
    with pytest.raises(SourceError, match=rf"0000\.txt:3: .*{expected}"):
        read(root)


BAD_PARTS = {
    "no P2": ({"calibration": calibration_text(P2="")}, r"calib/0000\.txt: P2 is missing"),
    "no velodyne": (
        {"calibration": calibration_text(Tr_velo_to_cam="")},
        r"calib/0000\.txt: Tr_velo_to_cam is missing",
    ),
    "broken matrix": (
        {"calibration": calibration_text(R0_rect="1 0 0")},
        r"calib/0000\.txt:2: R0_rect should be 9 or 12 numbers",
    ),
    "mirrored": (
        {"calibration": calibration_text(R0_rect="1 0 0 0 1 0 0 0 -1")},
        r"calib/0000\.txt:2: R0_rect is no rotation",
    ),
    "shifted far": (
        {"calibration": calibration_text(Tr_imu_to_velo="1 0 0 1e300 0 1 0 0 0 0 1 0")},
        r"calib/0000\.txt:4: Tr_imu_to_velo is no rotation, or shifts",
    ),
    "pole": (
        {"oxts": f"{oxts_text(2)}90 {oxts_text(1).split(maxsplit=1)[1]}"},
        r"oxts/0000\.txt:3: 90 in column 1 is absurd",
    ),
    "short oxts": (
        {"oxts": oxts_text(2)},
        r"det_02/0000\.txt: goes up to frame 2, .*oxts/0000\.txt has 2 lines",
    ),
    "empty oxts": ({"oxts": ""}, r"oxts/0000\.txt: holds no line"),
    "cut oxts": ({"oxts": oxts_text(3)[:-9]}, r"oxts/0000\.txt:3: 26 columns, expected 30"),
    "flat label": ({"labels": f"0 7 {CAR.replace('1.6', '0')}\n"}, r"label_02/0000\.txt:1: "),
    "late label": (
        {"labels": f"9 7 {CAR}\n"},
        r"label_02/0000\.txt: goes up to frame 9, .*oxts/0000\.txt has 3 lines",
    ),
    "absurd label": (
        {"labels": f"2 7 {CAR}\n2000000000 7 {CAR}\n"},
        r"label_02/0000\.txt:2: frame 2000000000 is more than 100,000 frames behind",
    ),
}


@pytest.mark.parametrize(("parts", "expected"), BAD_PARTS.values(), ids=BAD_PARTS.keys())
def test_bad_part_names_the_file(tmp_path: Path, parts: dict[str, str], expected: str) -> None:
    root = write_sequence(tmp_path, **parts)  # type: ignore[arg-type]
    with pytest.raises(SourceError, match=expected):
        read(root)


def test_sequence_without_detections_says_so(tmp_path: Path) -> None:
    root = write_sequence(write_sequence(tmp_path, "0000"), "0001")
    (root / "det_02" / "0001.txt").unlink()
    with pytest.raises(SourceError, match="sequence 0001: no detections in"):
        read(root, sequence=1)


def test_wrong_detection_folder_says_what_was_expected(tmp_path: Path) -> None:
    root = write_sequence(tmp_path / "source")
    (tmp_path / "detector" / "training").mkdir(parents=True)
    (tmp_path / "detector" / "training" / "0000.txt").touch()
    with pytest.raises(SourceError, match="no detections for any sequence"):
        read(root, tmp_path / "detector")
    with pytest.raises(SourceError, match="--detections"):
        read(root, tmp_path / "nowhere")


def test_detections_of_a_sequence_that_is_not_there(tmp_path: Path) -> None:
    """As when the detections of the other split are given."""
    root = write_sequence(tmp_path, "0000")
    (root / "det_02" / "0021.txt").write_text(f"0 {CAR} 0.9\n")
    handles = KittiSource(root, SourceOptions()).sequences()
    assert [handle.sequence_id for handle in handles] == ["0000", "0021"]
    with pytest.raises(FileNotFoundError, match="calib"):
        handles[1].read()


def test_fingerprint_follows_every_file(tmp_path: Path) -> None:
    root = write_sequence(tmp_path, labels=f"0 7 {CAR}\n")
    [handle] = KittiSource(root, SourceOptions()).sequences()
    seen = {handle.fingerprint()}
    for part in ("calib", "oxts", "label_02", "det_02"):
        _append(root / part / "0000.txt", " ")
        seen.add(handle.fingerprint())
    assert len(seen) == 5


# --- the real recordings ------------------------------------------------------------------------


def _lines(path: Path) -> list[str]:
    return path.read_text().splitlines()


def test_all_training_sequences_are_read_whole(test_data: Path) -> None:
    root, found = test_data / "kitti/training", test_data / "kitti/detections/virconv/training"
    handles = KittiSource(root, SourceOptions(found)).sequences()
    assert [handle.sequence_id for handle in handles] == [f"{n:04d}" for n in range(21)]
    for handle in handles:
        [reading] = handle.read()
        read_frames = frames_of(reading)
        name = f"{handle.sequence_id}.txt"
        assert len(read_frames) == len(_lines(root / "oxts" / name))
        assert sum(len(frame.boxes) for frame in read_frames) == len(_lines(found / name))
        assert reading.findings.problems == []
        if (root / "label_02" / name).is_file():
            assert reading.labels is not None
            assert len(reading.labels.object_id) == len(_lines(root / "label_02" / name))


def test_image_sizes_hold_all_image_boxes(test_data: Path) -> None:
    """Image boxes are clipped to the image, so the outermost ones of each camera touch its edge."""
    edges: dict[tuple[int, int], list[FloatArray]] = {}
    for split in ("training", "testing"):
        root = test_data / "kitti" / split
        found = test_data / "kitti/detections/pointrcnn" / split
        for handle in KittiSource(root, SourceOptions(found)).sequences():
            [reading] = handle.read()
            assert reading.calibration is not None
            size = (reading.calibration.image_width_px, reading.calibration.image_height_px)
            boxes = np.concatenate([frame.image_boxes for frame in frames_of(reading)])
            edges.setdefault(size, []).append(np.nanmax(boxes[:, 2:], axis=0))
    assert len(edges) == 5
    for size, outermost in edges.items():
        margin = np.array(size) - np.max(outermost, axis=0)
        assert (margin >= 0).all()
        assert (margin <= 1.5).all()


def test_parked_cars_stay_where_they_are(test_data: Path) -> None:
    """Ego poses, calibration and box conversion together: a median spread of 0.12 m at most."""
    spreads_m: list[float] = []
    found = test_data / "kitti/detections/virconv/training"
    for handle in KittiSource(test_data / "kitti/training", SourceOptions(found)).sequences():
        [reading] = handle.read()
        if reading.labels is None:
            continue
        poses = [frame.pose for frame in frames_of(reading)]
        labels = reading.labels
        cars = (labels.object_id >= 0) & (np.array(labels.class_names) == "Car")
        index = labels.frame_index[cars]
        rotation = Rotation.from_quat([pose.rotation for pose in poses]).as_matrix()[index]
        translation_m = np.array([pose.translation_m for pose in poses])[index]
        world = transform_boxes(labels.boxes[cars], rotation, translation_m)
        for car in np.unique(labels.object_id[cars]):
            path_m = world[labels.object_id[cars] == car, :2]
            if len(path_m) >= 20 and np.linalg.norm(path_m[-1] - path_m[0]) < 1.0:
                spread_m = np.linalg.norm(path_m - np.median(path_m, axis=0), axis=1)
                spreads_m.append(float(np.median(spread_m)))
    assert len(spreads_m) > 100
    assert np.median(spreads_m) < 0.12


def test_projected_boxes_lie_on_the_logged_image_boxes(test_data: Path) -> None:
    """Detectors derive the image box from the 3D box, so calibration and boxes must agree."""
    found = test_data / "kitti/detections/virconv/training"
    handle = KittiSource(test_data / "kitti/training", SourceOptions(found)).sequences()[0]
    [reading] = handle.read()
    assert reading.calibration is not None
    for frame in frames_of(reading):
        points = corners(frame.boxes)
        image = points @ reading.calibration.image_from_sensor[:, :3].T
        image += reading.calibration.image_from_sensor[:, 3]
        pixels = image[..., :2] / image[..., 2:]
        boxes = np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)
        inside = (frame.image_boxes[:, 0] > 1) & (frame.image_boxes[:, 2] < 1240)
        inside &= frame.image_boxes[:, 3] < 373
        np.testing.assert_allclose(boxes[inside], frame.image_boxes[inside], atol=0.5)


@pytest.mark.parametrize("with_oxts", [True, False])
@pytest.mark.parametrize("frame", ["99999999", "1e300"])
def test_an_absurd_frame_number_names_file_and_line(
    tmp_path: Path, with_oxts: bool, frame: str
) -> None:
    lines = [f"0 {CAR} 0.9", f"{frame} {CAR} 0.9", f"1 {CAR} 0.9"]
    root = write_sequence(tmp_path, detections=lines)
    if not with_oxts:
        (root / "oxts" / "0000.txt").unlink()
    with pytest.raises(SourceError, match=r"det_02/0000\.txt:2: frame "):
        read(root)


def test_a_file_whose_number_is_beyond_all_numbers(tmp_path: Path) -> None:
    root = write_sequence(tmp_path)
    (root / "det_02" / "0000.txt").unlink()
    path = root / "det_02" / "0000" / f"{'9' * 30}.txt"
    path.parent.mkdir()
    path.write_text(f"{CAR} 0.9\n")
    with pytest.raises(SourceError, match=rf"{path.name}: one file a frame is named by its number"):
        read(root)
