"""The direct walks say what the general readers say, whatever is in the messages."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores
from rosbags.typesys.store import Typestore

from hbbatch.sources.blocks import Payloads
from hbbatch.sources.cdr_columns import DETECTION_WALKS, TRANSFORM_WALKS
from hbbatch.sources.cdr_steps import WalkRefusedError
from hbbatch.sources.cdr_walk import CdrWalk
from hbbatch.sources.columns import DetectionColumns, from_messages, from_samples
from hbbatch.sources.messages import DETECTION_MESSAGES, POSE_MESSAGES, TRANSFORM_MESSAGES
from tests import log_families, logs

pytestmark = pytest.mark.usefixtures("cdr")

STORES = {
    "humble": log_families.store(Stores.ROS2_HUMBLE),
    "foxy": log_families.store(Stores.ROS2_FOXY, vision=1),
}
_TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
_FLOAT = st.floats(-1e6, 1e6, width=32)


def random_message(draw: st.DrawFn, types: Typestore, kind: str) -> Any:
    fields = {name: _value(draw, types, field) for name, field in types.fielddefs[kind][1]}
    return types.types[kind](**fields)


def _value(draw: st.DrawFn, types: Typestore, field: Any) -> Any:
    node, argument = field
    if node == Nodetype.NAME:
        return random_message(draw, types, argument)
    if node == Nodetype.BASE:
        return _base(draw, argument[0])
    inner, count = argument
    if inner[0] == Nodetype.BASE and inner[1][0] != "string":
        size = count if node == Nodetype.ARRAY else draw(st.integers(0, 3))
        return np.zeros(size, dtype={"byte": "uint8"}.get(inner[1][0], inner[1][0]))
    return [_value(draw, types, inner) for _ in range(draw(st.integers(0, 3)))]


def _base(draw: st.DrawFn, kind: str) -> Any:
    if kind == "string":
        return draw(_TEXT)
    if "float" in kind:
        return draw(_FLOAT)
    if kind == "bool":
        return draw(st.booleans())
    bits = int(kind.strip("uint") or 8)
    # Shapes of type 2 are polygons, which the walk leaves to the general reader.
    return draw(st.integers(0, min(2 ** (bits - 1) - 1, 10**9)).filter(lambda n: n != 2))


@st.composite
def batches(draw: st.DrawFn, types: Typestore, kind: str) -> list[bytes]:
    count = draw(st.integers(1, 4))
    messages = [random_message(draw, types, kind) for _ in range(count)]
    for message in messages:
        # Objects in another frame than their message are left to the general reader.
        for found in getattr(message, "detections", ()):
            found.header.frame_id = draw(st.sampled_from(["", message.header.frame_id]))
    return [bytes(types.serialize_cdr(message, kind)) for message in messages]


def read_one_by_one(types: Typestore, kind: str, batch: list[bytes]) -> DetectionColumns:
    read = DETECTION_MESSAGES[kind]
    return from_messages([read(types.deserialize_cdr(content, kind)) for content in batch])


def same(walked: DetectionColumns, read: DetectionColumns) -> None:
    np.testing.assert_array_equal(walked.stamp_ns, read.stamp_ns)
    np.testing.assert_array_equal(walked.box_counts, read.box_counts)
    np.testing.assert_array_equal(walked.boxes, read.boxes)
    np.testing.assert_array_equal(walked.scores, read.scores)
    assert walked.class_names.to_list() == read.class_names.to_list()
    assert walked.frame_ids.to_list() == read.frame_ids.to_list()
    assert walked.unsure_yaws == read.unsure_yaws


@pytest.mark.parametrize("kind", DETECTION_WALKS)
@pytest.mark.parametrize("release", STORES)
@settings(max_examples=12, deadline=None)
@given(data=st.data())
def test_random_detections(release: str, kind: str, data: st.DataObject) -> None:
    types = STORES[release]
    batch = data.draw(batches(types, kind))
    walked = DETECTION_WALKS[kind](types, kind)(Payloads.of(batch))
    same(walked, read_one_by_one(types, kind, batch))


@pytest.mark.parametrize("kind", TRANSFORM_WALKS)
@settings(max_examples=12, deadline=None)
@given(data=st.data())
def test_random_transforms(kind: str, data: st.DataObject) -> None:
    types = STORES["humble"]
    batch = data.draw(batches(types, kind))
    walked = TRANSFORM_WALKS[kind](types, kind)(Payloads.of(batch))
    several = TRANSFORM_MESSAGES.get(kind) or POSE_MESSAGES[kind]
    read = from_samples([list(several(types.deserialize_cdr(c, kind))) for c in batch])
    np.testing.assert_array_equal(walked.counts, read.counts)
    np.testing.assert_array_equal(walked.stamp_ns, read.stamp_ns)
    np.testing.assert_array_equal(walked.values, read.values)
    assert walked.parents.to_list() == read.parents.to_list()
    assert walked.children.to_list() == read.children.to_list()


@settings(max_examples=40, deadline=None)
@given(data=st.data(), place=st.floats(0, 1), value=st.integers(0, 255), cut=st.integers(0, 8))
def test_damaged_messages_are_refused_or_read_as_the_general_reader_does(
    data: st.DataObject, place: float, value: int, cut: int
) -> None:
    kind, types = "vision_msgs/msg/Detection3DArray", STORES["humble"]
    batch = data.draw(batches(types, kind))
    content = bytearray(batch[-1])
    content[int(place * (len(content) - 1))] = value
    batch[-1] = bytes(content[: len(content) - cut])
    try:
        walked = DETECTION_WALKS[kind](types, kind)(Payloads.of(batch))
    except WalkRefusedError:
        return
    same(walked, read_one_by_one(types, kind, batch))


def test_a_definition_of_another_layout_is_refused() -> None:
    types = STORES["humble"]
    with pytest.raises(WalkRefusedError, match="no field header"):
        CdrWalk(types, "geometry_msgs/msg/Point", ["header.frame_id"])


@pytest.mark.parametrize("kinds", [1, 5, 60])
def test_however_many_names_there_are(kinds: int) -> None:
    kind, types = "tf2_msgs/msg/TFMessage", STORES["humble"]
    names = [f"frame_{number % kinds}" * (1 + number % kinds % 3) for number in range(200)]
    transforms = [logs.transform(1, "map", name, (0, 0, 0)) for name in names]
    batch = [bytes(logs.STORE.serialize_cdr(message, kind)) for message in transforms]
    walked = TRANSFORM_WALKS[kind](types, kind)(Payloads.of(batch))
    assert walked.children.to_list() == names
    assert len(walked.children.vocabulary) == kinds


def test_texts_are_told_apart_by_all_of_their_letters_and_no_others() -> None:
    kind, types = "tf2_msgs/msg/TFMessage", STORES["humble"]
    names = ["pedestrian", "pedestrians", "pedestriam", "car", "", "pedestrian", "ä" * 8, "x" * 999]
    names += [f"{'a' * 8}{middle}{'b' * 8}" for middle in "cd"]
    transforms = [logs.transform(1, name, name[::-1], (0, 0, 0)) for name in names]
    batch = [bytes(logs.STORE.serialize_cdr(message, kind)) for message in transforms]
    walked = TRANSFORM_WALKS[kind](types, kind)(Payloads.of(batch))
    assert walked.parents.to_list() == names
    assert walked.children.to_list() == [name[::-1] for name in names]
    assert len(walked.parents.vocabulary) == len(set(names))


def test_numbers_of_a_fixed_array_are_no_column() -> None:
    with pytest.raises(WalkRefusedError, match="is in a fixed array"):
        CdrWalk(
            STORES["humble"], "geometry_msgs/msg/PoseWithCovarianceStamped", ["pose.covariance[]"]
        )
