"""docs/formats.md lists what the tables of the code list."""

from __future__ import annotations

from pathlib import Path

from hbbatch import schema
from hbbatch.sources.classes import TAXONOMY
from hbbatch.sources.messages import (
    DETECTION_MESSAGES,
    POSE_MESSAGES,
    SATELLITE_MESSAGES,
    TRANSFORM_MESSAGES,
)

DOCS = (Path(__file__).parents[2] / "docs/formats.md").read_text()


def test_every_message_type_is_documented() -> None:
    tables = (DETECTION_MESSAGES, TRANSFORM_MESSAGES, POSE_MESSAGES, SATELLITE_MESSAGES)
    for kind in (kind for table in tables for kind in table):
        package, _, name = kind.split("/")
        assert name in DOCS, kind
        assert package in DOCS, kind


def test_every_class_is_documented() -> None:
    for name, spellings in TAXONOMY.items():
        listed = ", ".join(f"`{spelling}`" for spelling in spellings if spelling)
        assert f"| `{name}` | {listed} |" in DOCS


def test_every_column_of_the_tracks_is_documented() -> None:
    table = DOCS.partition("The columns of `tracks`:")[2].partition("\n## ")[0]
    listed = [row.split("|")[1] for row in table.splitlines() if row.startswith("| `")]
    names = [name.strip(" `") for cell in listed for name in cell.split(",")]
    assert names == schema.TRACKS.names
