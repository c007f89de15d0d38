"""Tables explain themselves, and what does not fit them is refused by name."""

from __future__ import annotations

import pyarrow as pa
import pytest

from hbbatch import schema
from hbbatch.errors import DatasetError

TABLES = ("DETECTIONS", "POSES", "TRACKS", "LABELS", "CATALOG", "TIMING")


@pytest.mark.parametrize("name", TABLES)
def test_every_field_has_a_unit_and_a_description(name: str) -> None:
    for field in getattr(schema, name):
        assert b"unit" in field.metadata
        assert field.metadata[b"description"]


SMALL = pa.schema([pa.field("n", pa.int32(), False), pa.field("x", pa.float64(), True)])


def test_conforming_drops_what_is_extra_and_fills_what_may_be_null() -> None:
    table = schema.conform(pa.table({"other": ["a"], "n": pa.array([1], pa.int64())}), SMALL, "t")
    assert table.schema == SMALL
    assert table.to_pylist() == [{"n": 1, "x": None}]


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({"x": [1.0]}, "t: column 'n' is missing. It holds: x"),
        ({"n": ["one"]}, "t: column 'n' is string, expected int32"),
        ({"n": [2**40]}, "t: column 'n' is int64, expected int32"),
        ({"n": pa.array([None], pa.int32())}, "t: column 'n' holds 1 nulls"),
    ],
)
def test_a_column_that_does_not_fit_is_named(columns: dict[str, object], expected: str) -> None:
    with pytest.raises(DatasetError) as caught:
        schema.conform(pa.table(columns), SMALL, "t")
    assert str(caught.value).startswith(expected)
