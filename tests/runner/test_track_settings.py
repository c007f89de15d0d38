"""Settings of a run from a file and from options."""

from __future__ import annotations

from pathlib import Path

import pytest

from hbbatch.errors import ConfigError
from hbbatch.runner.track_settings import resolve_settings


def test_options_win_over_the_config_file(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text("filter: kalman\nmin_score: 0.5\noutput: {protocol: online}\n")
    settings = resolve_settings(config, {"min_score": 0.7, "classes": None})
    assert (settings.filter, settings.min_score) == ("kalman", 0.7)
    assert settings.output.protocol == "online"
    gap_filled = resolve_settings(config, {"output": {"protocol": "gap_filled"}})
    assert gap_filled.output.protocol == "gap_filled"
    config.write_text("output: {protocol: online, min_detections: 3}\n")
    assert resolve_settings(config, {"output": {"max_coasted": 2}}).output.min_detections == 3


def test_weights_of_a_config_file_lie_beside_it(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text("weights: mine.safetensors\n")
    assert resolve_settings(config, {}).weights == str(tmp_path / "mine.safetensors")
    assert resolve_settings(config, {"weights": "x.safetensors"}).weights == "x.safetensors"


def test_a_config_file_with_an_unknown_key_is_refused(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text("fliter: kalman\n")
    with pytest.raises(ConfigError, match=r"c\.yaml: fliter"):
        resolve_settings(config, {})
