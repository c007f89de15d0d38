"""Settings: what is refused, how a fault is said, and what a digest tells apart."""

from __future__ import annotations

import pytest
from pydantic import Field

from hbbatch.config import (
    AssociationSettings,
    OutputSettings,
    Settings,
    TrackSettings,
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
