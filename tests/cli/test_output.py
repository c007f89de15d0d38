"""What several commands print."""

from __future__ import annotations

import pytest

from hbbatch.cli.output import complain_of


def test_errors_that_differ_in_the_sequence_only_are_one_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    complain_of(
        [
            ("", "log.mcap: an empty file"),
            ("0001", "sequence 0001: data/0001.parquet is missing"),
            ("0002", "sequence 0002: data/0002.parquet is missing"),
            ("0003", "sequence 0003: the disk is full"),
        ]
    )
    assert capsys.readouterr().err.splitlines() == [
        "error: log.mcap: an empty file",
        "error: sequence 0001: data/0001.parquet is missing (and 1 more like it; see --json)",
        "error: sequence 0003: the disk is full",
    ]
