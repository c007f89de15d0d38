"""YAML files: read safely, and refused where they cannot be meant."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from hbbatch.errors import ConfigError
from hbbatch.yaml_files import load_yaml


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[1]", "holds a list"),
        ("a: [", "not valid YAML"),
        ("!!python/object/apply:os.getcwd []", "not valid YAML"),
        ("filter: kalman\nfilter: hybrid", "not valid YAML .'filter' is given twice"),
        ("a: !!map foo", "not valid YAML"),
        ("output: {min_score: 1, min_score: 2}", "not valid YAML .'min_score' is given twice"),
    ],
)
def test_yaml_that_is_no_mapping_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=rf"c\.yaml: {expected}"):
        load_yaml(path)


def test_a_key_that_replaces_a_merged_one_is_given_once(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    text = "base: &base {a: 1}\nmid: &mid {<<: *base, a: 2}\n<<: *mid\n1: x\n'1': y\n"
    path.write_text(text)
    assert load_yaml(path) == yaml.safe_load(text)


def test_an_empty_file_holds_no_settings(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.touch()
    assert load_yaml(path) == {}


def test_yaml_beyond_all_depth_is_no_yaml(tmp_path: Path) -> None:
    path = tmp_path / "deep.yaml"
    path.write_text("[" * 3000)
    with pytest.raises(ConfigError, match="not valid YAML"):
        load_yaml(path)
