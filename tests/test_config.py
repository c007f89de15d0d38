"""Settings: what is refused, how a fault is said, and what a digest tells apart."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from pydantic import Field

from hbbatch.config import (
    AssociationSettings,
    OutputSettings,
    Settings,
    TrackSettings,
    TrainSettings,
    load_yaml,
    validate,
)
from hbbatch.errors import ConfigError


class Inner(Settings):
    size: int = 1


class Outer(Settings):
    one: Inner = Inner()
    many: tuple[Inner, ...] = ()
    named: dict[str, dict[str, Inner]] = Field({})


def fault(model: type[Settings], content: dict[str, object]) -> str:
    with pytest.raises(ConfigError) as caught:
        validate(model, content, "settings.yaml")
    return str(caught.value)


@pytest.mark.parametrize("number", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize(
    "content",
    [
        lambda x: {"min_score": x},
        lambda x: {"association": {"max_cost": x}},
        lambda x: {"output": {"min_track_score": x}},
        lambda x: {"output": {"score_scale": {"car": {"typical": 0.0, "strong": x}}}},
    ],
)
def test_numbers_must_be_finite(number: float, content: object) -> None:
    assert "finite number" in fault(TrackSettings, content(number))  # type: ignore[operator]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ({"two": 1}, "settings.yaml: two: unknown setting; known are one, many, named."),
        ({"one": {"sise": 1}}, "settings.yaml: one.sise: unknown setting; known are size."),
        ({"many": [{}, {"s": 1}]}, "settings.yaml: many.1.s: unknown setting; known are size."),
        (
            {"named": {"a": {"size": {"s": 1}}}},
            "settings.yaml: named.a.size.s: unknown setting; known are size.",
        ),
    ],
)
def test_an_unknown_setting_is_named_with_those_there_are(
    content: dict[str, object], expected: str
) -> None:
    assert fault(Outer, content) == expected


def test_every_fault_is_in_the_one_line() -> None:
    text = fault(TrackSettings, {"filter": "particle", "management": {"max_misses": 0}})
    assert "filter: " in text
    assert "management.max_misses: " in text
    assert "\n" not in text


def test_minimum_of_the_damping_must_not_exceed_its_maximum() -> None:
    assert "minimum must not exceed" in fault(
        TrackSettings, {"damping": {"minimum": 0.9, "maximum": 0.1}}
    )


def test_a_strong_score_must_exceed_a_typical_one() -> None:
    scale = {"car": {"typical": 1.0, "strong": 1.0}}
    assert "strong must exceed typical" in fault(TrackSettings, {"output": {"score_scale": scale}})


def test_a_likelihood_needs_an_update_that_learns_from_it() -> None:
    with pytest.raises(ConfigError, match="likelihood_weight teaches the update"):
        validate(TrainSettings, {"likelihood_weight": 0.03}, "mine.yaml")
    content = {"likelihood_weight": 0.03, "learn": "both"}
    assert validate(TrainSettings, content, "mine.yaml").likelihood_weight


@pytest.mark.parametrize(("typical", "strong"), [(0.5, 4.0), (-1.0, 0.9), (0.9995, 0.9999)])
def test_probabilities_as_scores_must_lie_where_their_logits_differ(
    typical: float, strong: float
) -> None:
    scale = {"typical": typical, "strong": strong, "probability": True}
    text = fault(TrackSettings, {"output": {"score_scale": {"car": scale}}})
    assert text.startswith("settings.yaml: output.score_scale.car: probabilities lie in 0..1")


def test_the_digest_changes_with_any_value_and_with_nothing_else() -> None:
    settings = TrackSettings()
    assert settings.digest() == TrackSettings().digest()
    others = [
        TrackSettings(filter="kalman"),
        TrackSettings(min_score=0.0),
        TrackSettings(output=OutputSettings(min_track_score={"car": 0.5})),
        TrackSettings(association=AssociationSettings(max_cost=1.0)),
    ]
    assert len({each.digest() for each in (settings, *others)}) == len(others) + 1


def test_the_threshold_is_that_of_the_cost_unless_given() -> None:
    assert AssociationSettings(cost="l2").threshold == 4.0
    assert AssociationSettings(cost="l2", max_cost=2.5).threshold == 2.5


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


@pytest.mark.parametrize(
    "content",
    [
        {"classes": []},
        {"management": {"max_misses": 10**18}},
        {"management": {"max_misses": 10**30}},
    ],
)
def test_settings_that_cannot_be_meant_are_refused(content: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=r"^c\.yaml: (classes|management\.max_misses): "):
        validate(TrackSettings, content, "c.yaml")


def test_yaml_beyond_all_depth_is_no_yaml(tmp_path: Path) -> None:
    path = tmp_path / "deep.yaml"
    path.write_text("[" * 3000)
    with pytest.raises(ConfigError, match="not valid YAML"):
        load_yaml(path)
