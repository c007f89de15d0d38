"""Classes that settings name, in the spelling that datasets record."""

from __future__ import annotations

import pytest

from hbbatch.config import ConfidenceWeights, TrackSettings, validate
from hbbatch.errors import ConfigError
from hbbatch.runner.class_names import normalised_classes

SCALE = {"typical": 1.0, "strong": 2.0}


def settings(**output: object) -> TrackSettings:
    return validate(TrackSettings, {"output": output}, "settings.yaml")


def test_classes_are_normalised_wherever_they_are_named() -> None:
    found = normalised_classes(
        settings(score_scale={"Car": SCALE}, min_track_score={"Person sitting": 0.5}),
        "settings.yaml",
    ).output
    assert list(found.score_scale) == ["car"]
    assert found.min_track_score == {"person_sitting": 0.5}


def test_a_cut_for_all_classes_stays_as_it_is() -> None:
    assert normalised_classes(settings(min_track_score=0.5), "s.yaml").output.min_track_score == 0.5


@pytest.mark.parametrize("setting", ["score_scale", "min_track_score"])
def test_a_class_that_no_filter_tracks_is_named(setting: str) -> None:
    value = SCALE if setting == "score_scale" else 0.5
    with pytest.raises(
        ConfigError, match=rf"s.yaml: output.{setting}: unknown 'spaceship'. Known are car"
    ):
        normalised_classes(settings(**{setting: {"car": value, "spaceship": value}}), "s.yaml")


def test_confidence_is_by_kind_not_by_class() -> None:
    names = ConfidenceWeights.model_fields
    weights = dict.fromkeys(("detected", "undetected"), dict.fromkeys(names, 0.0))
    with pytest.raises(ConfigError, match=r"unknown 'car'. Known are vehicle, pedestrian, cyclist"):
        normalised_classes(settings(confidence={"online": {"car": weights}}), "s.yaml")


def test_confidence_of_an_older_version_says_what_to_do() -> None:
    old = dict.fromkeys(ConfidenceWeights.model_fields, 0.0)
    with pytest.raises(ConfigError, match="Make the file again with hbbatch calibrate") as caught:
        settings(confidence={"online": {"vehicle": old}})
    assert str(caught.value).count("output.confidence") == 1
