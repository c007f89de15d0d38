"""The compiled walk: nothing is read beyond a message, whatever lengths it claims, or written
beyond a column, whatever it is told. What it reads is tested in `test_cdr_columns.py`."""

from __future__ import annotations

import contextlib
import struct
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from hbbatch.sources.blocks import Payloads
from hbbatch.sources.cdr_steps import Operation, WalkRefusedError, compiled
from hbbatch.sources.cdr_walk import CdrWalk

pytestmark = pytest.mark.usefixtures("cdr")

HEAD = b"\x00\x01\x00\x00"
KIND = "test_msgs/msg/Found"
DEFINITION = """
int8 small
uint16 medium
int64 large
Item[] items
================================================================================
MSG: test_msgs/Item
string name
float32 score
uint8[] rest
float64[3] place
bool[] flags
"""


def store(definition: str = DEFINITION) -> Typestore:
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(definition, KIND))
    return types


TYPES = store()
FIELDS = ("small", "medium", "large", "items[].name", "items[].score")


def walk(*fields: str) -> CdrWalk:
    return CdrWalk(TYPES, KIND, fields or FIELDS)


def message(*names: str) -> bytes:
    item, found = (TYPES.types[f"test_msgs/msg/{name}"] for name in ("Item", "Found"))
    items = [
        item(
            name=name,
            score=n + 0.5,
            rest=np.zeros(n, np.uint8),
            place=np.zeros(3),
            flags=np.zeros(n % 2, np.bool_),
        )
        for n, name in enumerate(names)
    ]
    content = found(small=-1, medium=65535, large=-(2**62), items=items)
    return bytes(TYPES.serialize_cdr(content, KIND))


def test_numbers_of_all_widths_and_signs() -> None:
    columns = walk().read(Payloads.of([message("a", "b", "a"), message()]))
    assert columns.numbers["small"].tolist() == [-1, -1]
    assert columns.numbers["medium"].tolist() == [65535, 65535]
    assert columns.numbers["large"].tolist() == [-(2**62)] * 2
    assert columns.counts["items"].tolist() == [3, 0]
    assert columns.numbers["items[].score"].tolist() == [0.5, 1.5, 2.5]
    assert columns.texts["items[].name"].to_list() == ["a", "b", "a"]


def test_no_message_is_read_beyond_its_end() -> None:
    """Whatever is cut off: what follows in the buffer belongs to another message."""
    whole = message("car", "pedestrian")
    for end in range(len(whole)):
        lying = Payloads(whole, np.array([0]), np.array([end]))
        with pytest.raises(WalkRefusedError):
            walk().read(lying)


@pytest.mark.parametrize("claimed", [2, 2**20, 2**31, 2**32 - 1])
def test_lengths_that_lie_are_refused(claimed: int) -> None:
    whole = message("car")
    for place in range(4, len(whole) - 4):
        wrong = bytearray(whole)
        wrong[place : place + 4] = struct.pack("<I", claimed)
        try:
            columns = walk().read(Payloads.of([bytes(wrong)]))
        except WalkRefusedError:
            continue
        assert len(columns.numbers["items[].score"]) == columns.counts["items"].sum() == 1


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (b"", "little endian"),
        (b"\x00\x01\x00", "little endian"),
        (b"\x00\x00" + message()[2:], "little endian"),
        (b"\x00\x03" + message()[2:], "little endian"),
        (message() + bytes(4), "longer"),
        (message("car").replace(b"car\0", b"car!"), "without end"),
        (message("car").replace(b"car\0", b"c\xffr\0"), "utf-8"),
        (message("").replace(b"\x01\0\0\0\0", b"\0\0\0\0\0"), "without end"),
    ],
)
@pytest.mark.parametrize("fields", [FIELDS, ("small",)], ids=["wanted", "passed"])
def test_bytes_that_are_no_such_message_are_refused(
    wrong: bytes, why: str, fields: tuple[str, ...]
) -> None:
    with pytest.raises(WalkRefusedError, match=why):
        walk(*fields).read(Payloads.of([message("car"), wrong]))


def test_fill_bytes_behind_a_message_are_passed() -> None:
    assert walk().read(Payloads.of([message() + bytes(3)])).numbers["small"].tolist() == [-1]


def test_elements_that_take_no_bytes_are_refused() -> None:
    types = store(f"int32 number\nNone[] many\n{'=' * 80}\nMSG: test_msgs/None\nint8[0] no")
    with pytest.raises(WalkRefusedError, match="elements without fields"):
        compiled(types, KIND, ["number"])


@pytest.mark.parametrize("count", [5000, 10**9])
def test_definitions_that_multiply_fields_are_refused_at_once(count: int) -> None:
    types = store(f"int32 number\nOne[{count}] many\n{'=' * 80}\nMSG: test_msgs/One\nint8 a")
    with pytest.raises(WalkRefusedError, match="too many fields"):
        compiled(types, KIND, ["number"])


def test_long_arrays_of_numbers_are_one_step() -> None:
    layout = compiled(store("float64[1000000] many\nint32 number"), KIND, ["number"])
    assert layout.steps[:, 0].tolist() == [Operation.TAKE, Operation.ALIGN]


def arguments() -> list[Any]:
    """A call that fits."""
    whole = message("car")
    layout = compiled(TYPES, KIND, FIELDS)
    room = np.array([[1, 9], [0, 0]])
    firsts = np.arange(len(layout.columns)) * 9
    bounds = np.array([0]), np.array([len(whole)])
    return [layout.steps, whole, *bounds, firsts, room, np.zeros(9 * len(firsts), int), [{}]]


def test_arguments_that_do_not_fit_are_refused(cdr: ModuleType) -> None:
    right = arguments()
    cdr.walk(*right)
    assert right[5][1].tolist() == [1, 1]
    with pytest.raises(ValueError, match="number of arguments"):
        cdr.walk(*right[:-1])
    for place, value in enumerate(right):
        unfit: list[Any] = [None, "text", np.zeros(3, np.float32)]
        if isinstance(value, np.ndarray):
            unfit += [value[None], value.astype(np.int32), value.astype(">i8"), value[:0]]
        for wrong in unfit:
            with pytest.raises((ValueError, TypeError, BufferError)):
                cdr.walk(*right[:place], wrong, *right[place + 1 :])


@pytest.mark.parametrize("bound", [-1, 2**62, -(2**63)])
@pytest.mark.parametrize("place", [2, 3, 4, 5])
def test_places_beyond_are_refused(cdr: ModuleType, place: int, bound: int) -> None:
    wrong = arguments()
    wrong[place].flat[0] = bound
    with pytest.raises(ValueError, match=r"do not agree|beyond the buffer|little endian"):
        cdr.walk(*wrong)


def test_elements_for_which_there_is_no_room_are_refused(cdr: ModuleType) -> None:
    wrong = arguments()
    wrong[5][0, 1] = 0
    with pytest.raises(ValueError, match="beyond"):
        cdr.walk(*wrong)


def test_any_steps_are_checked(cdr: ModuleType) -> None:
    """Steps of random numbers are refused or lead nowhere beyond what is there."""
    rng = np.random.default_rng(0)
    guard = 100
    for _ in range(3000):
        given = arguments()
        steps, cells = given[0].copy(), given[6]
        for _ in range(rng.integers(1, 4)):
            steps[rng.integers(len(steps)), rng.integers(5)] = rng.integers(-2, 20)
        guarded = np.full(len(cells) + 2 * guard, 77)
        given[0], given[6] = steps, guarded[guard:-guard]
        with contextlib.suppress(ValueError):
            cdr.walk(*given)
        assert (guarded[:guard] == 77).all()
        assert (guarded[-guard:] == 77).all()


def test_an_array_longer_than_any_number_is_refused() -> None:
    types = store(f"uint8[{10**30}] x\nint32 y\n")
    with pytest.raises(WalkRefusedError, match="beyond all memory"):
        compiled(types, KIND, ("y",))
