"""Messages in blocks: what comes out is what went in, whichever way they were put together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from hbbatch.sources.blocks import Block, BlockBuilder, Payloads, gather, in_blocks
from hbbatch.sources.channels import Channel, RawMessage

LEFT, RIGHT = (Channel(topic, "a/msg/B", "cdr", "ros2msg", b"") for topic in ("/left", "/right"))


def messages_of(blocks: Sequence[Block]) -> list[RawMessage]:
    return [message for block in blocks for message in block.messages()]


def spans(*bounds: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    starts, ends = np.array(bounds, dtype=np.int64).T
    return starts, ends


def test_messages_read_one_by_one_keep_their_order() -> None:
    messages = [
        RawMessage(LEFT, 3, b"one"),
        RawMessage(RIGHT, 1, b""),
        RawMessage(LEFT, 2, b"three"),
    ]
    assert messages_of(list(in_blocks(iter(messages)))) == messages


def test_rows_of_payloads() -> None:
    payloads = Payloads.of([b"a", b"bc", b""])
    assert list(payloads[np.array([2, 1])]) == [b"", b"bc"]


@pytest.mark.parametrize(
    "piece", [b"..wanted..", b"wanted" + bytes(100)], ids=["kept whole", "mostly of no use"]
)
def test_what_is_built_of_pieces(piece: bytes) -> None:
    builder = BlockBuilder(capacity=1000)
    start = piece.index(b"wanted")
    bounds = spans((start, start + 3), (start + 3, start + 6))
    for time_ns in (5, 7):
        builder.add(piece, *bounds, np.array([1, 0]), np.array([time_ns, time_ns]))
    assert messages_of(list(builder.take([LEFT, RIGHT]))) == [
        RawMessage(RIGHT, 5, b"wan"),
        RawMessage(LEFT, 5, b"ted"),
        RawMessage(RIGHT, 7, b"wan"),
        RawMessage(LEFT, 7, b"ted"),
    ]
    assert list(builder.take([LEFT])) == []


def test_of_a_piece_that_is_mostly_of_no_use_only_the_messages_take_room() -> None:
    builder = BlockBuilder(capacity=1000)
    for _ in range(10):
        builder.add(bytes(900), *spans((0, 9)), np.array([0]), np.array([0]))
    (block,) = builder.take([LEFT])
    assert len(block.payloads) == 10
    assert block.payloads.ends.max() == 90


def test_a_piece_larger_than_a_block_fits_an_empty_one_only() -> None:
    builder = BlockBuilder(capacity=10)
    assert builder.fits(50)
    builder.add(bytes(range(50)), *spans((0, 50)), np.array([0]), np.array([0]))
    assert not builder.fits(1)
    assert messages_of(list(builder.take([LEFT]))) == [RawMessage(LEFT, 0, bytes(range(50)))]
    assert builder.fits(50)


def test_numbers_are_gathered_from_anywhere() -> None:
    data = b"\0" + np.array([1.5, -2.0]).tobytes() + b"\0" * 3
    found = gather(data, np.array([9, 1]), np.dtype("<f8"))
    assert found.tolist() == [-2.0, 1.5]
    with pytest.raises(IndexError):
        gather(data, np.array([len(data) - 7]), np.dtype("<f8"))
    with pytest.raises(IndexError):
        gather(b"short", np.array([0]), np.dtype("<f8"))
