"""Class names of detectors and data sets in one taxonomy."""

from __future__ import annotations

from pathlib import Path

import pytest

from hbbatch.sources.classes import TAXONOMY, is_known_class, normalise_class


@pytest.mark.parametrize(
    ("logged", "expected"),
    [
        ("Car", "car"),
        ("Person_sitting", "person_sitting"),
        ("DontCare", "dont_care"),
        ("PEDESTRIAN", "pedestrian"),
        ("traffic cone", "traffic_cone"),
        ("motorbike", "motorcycle"),
        ("", "unknown"),
        ("forklift", "unknown"),
    ],
)
def test_normalised(logged: str, expected: str) -> None:
    assert normalise_class(logged) == expected


def test_every_name_of_the_taxonomy_is_its_own() -> None:
    assert all(normalise_class(name) == name for name in TAXONOMY)


def test_no_spelling_means_two_classes() -> None:
    spellings = [s for name, others in TAXONOMY.items() for s in (name, *others)]
    assert len({s.replace("_", "") for s in spellings}) == len(spellings)


def test_unknown_names_are_told_apart_from_the_class_unknown() -> None:
    assert is_known_class("unknown")
    assert not is_known_class("forklift")


def test_documented_table_is_the_one_in_use() -> None:
    page = (Path(__file__).parents[2] / "docs" / "formats.md").read_text()
    for name, spellings in TAXONOMY.items():
        known_as = ", ".join(f"`{spelling}`" for spelling in spellings if spelling)
        assert f"| `{name}` | {known_as} |" in page
