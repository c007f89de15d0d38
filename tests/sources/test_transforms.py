"""The transform tree: chains, interpolation, bounds and the choice of the world."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hbbatch.sources.columns import from_samples
from hbbatch.sources.log_poses import PoseMessages
from hbbatch.sources.messages import TransformSample
from hbbatch.sources.transforms import EXTRAPOLATION_NS, TransformTree, usable
from tests.logs import about_z

SECOND = 1_000_000_000
_NO_TURN = (0.0, 0.0, 0.0, 1.0)


def add(
    tree: TransformTree,
    parent: str,
    child: str,
    time_ns: int,
    x: float = 0.0,
    rotation: tuple[float, float, float, float] = _NO_TURN,
    *,
    static: bool = False,
) -> bool:
    columns = from_samples([[TransformSample(parent, child, time_ns, (x, 0.0, 0.0), rotation)]])
    tree.add(columns, columns.stamp_ns, static=static)
    return bool(usable(columns)[0])


def driving_tree() -> TransformTree:
    """From 10 s to 11 s the car moves from x = 0 to 10 and turns left by 90 degrees."""
    tree = TransformTree()
    add(tree, "base_link", "lidar", 99 * SECOND, 2.0, static=True)
    add(tree, "map", "base_link", 11 * SECOND, 10.0, about_z(np.pi / 2))
    add(tree, "map", "base_link", 10 * SECOND, 0.0)
    return tree


def test_between_samples_position_is_linear_and_rotation_slerp() -> None:
    poses = driving_tree().poses("lidar", "map", np.array([10 * SECOND + SECOND // 2]))
    half = Rotation.from_euler("z", 45, degrees=True)
    np.testing.assert_allclose(poses.rotation, [half.as_quat()], atol=1e-12)
    np.testing.assert_allclose(
        poses.translation_m, half.apply([[2, 0, 0]]) + np.array([5, 0, 0]), atol=1e-12
    )
    assert not poses.exact[0]
    assert poses.known[0]


def test_at_a_sample_the_pose_is_the_logged_one() -> None:
    poses = driving_tree().poses("lidar", "map", np.array([10, 11]) * SECOND)
    np.testing.assert_allclose(poses.translation_m, [[2, 0, 0], [10, 2, 0]], atol=1e-12)
    turned = driving_tree().poses("base_link", "map", np.array([10, 11]) * SECOND)
    np.testing.assert_array_equal(turned.translation_m, [[0, 0, 0], [10, 0, 0]])
    assert poses.exact.all()


def test_carried_on_for_a_tenth_of_a_second_and_no_further() -> None:
    last = 11 * SECOND
    stamps = np.array([last + EXTRAPOLATION_NS, last + EXTRAPOLATION_NS + 1])
    poses = driving_tree().poses("base_link", "map", stamps)
    assert poses.known.tolist() == [True, False]
    np.testing.assert_allclose(poses.translation_m[0], [11, 0, 0], atol=1e-12)


@given(st.permutations(range(5)))
def test_order_of_arrival_does_not_matter(order: list[int]) -> None:
    tree = TransformTree()
    for k in order:
        add(tree, "odom", "base_link", k * SECOND, float(k * k))
    poses = tree.poses("base_link", "odom", np.array([2 * SECOND, 3 * SECOND + SECOND // 4]))
    np.testing.assert_allclose(poses.translation_m[:, 0], [4.0, 9 + 7 / 4], atol=1e-9)


def test_a_single_moving_sample_holds_near_its_time() -> None:
    tree = TransformTree()
    add(tree, "map", "base_link", 10 * SECOND, 3.0)
    poses = tree.poses("base_link", "map", np.array([10 * SECOND + 1, 12 * SECOND]))
    np.testing.assert_allclose(poses.translation_m[0], [3, 0, 0])
    assert poses.known.tolist() == [True, False]


@pytest.mark.parametrize(
    ("chain", "world"),
    [
        (("map", "odom", "base_link"), "map"),
        (("odom", "base_link"), "odom"),
        (("utm", "base_link"), "utm"),
        (("earth", "map", "base_link"), "map"),
        (("robot/odom", "base_link"), "robot/odom"),
        (("/map", "/base_link"), "map"),
    ],
)
def test_world_is_found_above_the_sensor(chain: tuple[str, ...], world: str) -> None:
    tree = TransformTree()
    for parent, child in pairwise(chain):
        add(tree, parent, child, SECOND)
    assert tree.world_of("base_link") == world


def test_a_tree_in_which_nothing_moves_has_a_world_only_by_name() -> None:
    tree = TransformTree()
    add(tree, "base_link", "lidar", SECOND, static=True)
    assert tree.world_of("lidar") is None
    add(tree, "map", "base_link", SECOND, static=True)
    assert tree.world_of("lidar") == "map"


def test_a_loop_of_frames_ends() -> None:
    tree = TransformTree()
    add(tree, "a", "b", SECOND)
    add(tree, "b", "a", SECOND)
    assert tree.world_of("a") == "b"


def test_of_two_parents_the_one_said_most_often_counts() -> None:
    tree = TransformTree()
    add(tree, "base_link", "lidar", SECOND)
    add(tree, "odom", "lidar", SECOND)
    add(tree, "odom", "lidar", 2 * SECOND)
    assert tree.world_of("lidar") == "odom"
    assert tree.ambiguous() == ["lidar"]


@pytest.mark.parametrize(
    "rotation",
    [
        (0.0, 0.0, 0.0, 0.0),
        (float("nan"), 0.0, 0.0, 1.0),
        (0.0, 0.0, 1e-300, 0.0),
        (0.0, 0.0, 1e200, 0.0),
    ],
)
def test_what_is_no_rotation_is_refused(rotation: tuple[float, float, float, float]) -> None:
    assert not add(TransformTree(), "map", "base_link", SECOND, rotation=rotation)


def test_a_quaternion_of_any_length_is_the_rotation_it_points_to() -> None:
    tree = TransformTree()
    add(tree, "map", "base_link", SECOND, rotation=(0.0, 0.0, 3.0, 3.0))
    poses = tree.poses("base_link", "map", np.array([SECOND]))
    np.testing.assert_allclose(poses.rotation, [about_z(np.pi / 2)], atol=1e-12)


def test_without_a_stamp_the_log_time_counts() -> None:
    poses = PoseMessages()
    columns = from_samples([[TransformSample("map", "base_link", 0, (1.0, 0, 0), _NO_TURN)]])
    poses.add_transforms("/tf", columns, np.array([7 * SECOND]))
    assert poses.tree.poses("base_link", "map", np.array([7 * SECOND])).exact[0]
