"""Names that may be files, tables that can be trusted, sequences that go."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hbbatch import schema
from hbbatch.dataset import Dataset
from hbbatch.dataset.store import check_name, safe_name
from hbbatch.errors import DatasetError, UsageError
from tests.runner.small_dataset import make_dataset


@given(st.text())
def test_any_text_becomes_a_name_that_passes(text: str) -> None:
    assert check_name(safe_name(text), "name") == safe_name(text)


@pytest.mark.parametrize("name", ["", ".", "..", "../up", "a/b", "a b", "-x", "ü", "a" * 129])
def test_names_that_could_leave_the_folder_are_refused(name: str) -> None:
    with pytest.raises(UsageError, match="cannot be a file name"):
        check_name(name, "run name")


def test_a_garbage_catalogue_is_named_once_with_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "catalog.parquet").write_text("garbage that is no Parquet")
    with pytest.raises(DatasetError) as caught:
        Dataset.open(tmp_path)
    assert str(caught.value).count("catalog.parquet") == 1
    assert "Restore it, or delete it and make it again." in str(caught.value)


def test_a_newer_dataset_is_refused(tmp_path: Path) -> None:
    make_dataset(tmp_path, "a")
    path = tmp_path / "catalog.parquet"
    newer = {b"hbbatch_format_version": str(schema.FORMAT_VERSION + 1).encode()}
    pq.write_table(pq.read_table(path).replace_schema_metadata(newer), path)
    with pytest.raises(DatasetError, match="newer hbbatch"):
        Dataset.open(tmp_path)


def test_a_dropped_sequence_takes_its_tables_and_no_other(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path, "a", "b")
    dataset.drop_sequence("a")
    assert not list(tmp_path.rglob("*sequence_id=a*"))
    assert dataset.detections("b").num_rows
    assert isinstance(dataset.poses("b"), pa.Table)
