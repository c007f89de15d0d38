"""Settings of training: what does not go together is refused."""

from __future__ import annotations

import pytest

from hbbatch.config import validate
from hbbatch.errors import ConfigError
from hbbatch.model.train_settings import TrainSettings


def test_a_likelihood_needs_an_update_that_learns_from_it() -> None:
    with pytest.raises(ConfigError, match="likelihood_weight teaches the update"):
        validate(TrainSettings, {"likelihood_weight": 0.03}, "mine.yaml")
    content = {"likelihood_weight": 0.03, "learn": "both"}
    assert validate(TrainSettings, content, "mine.yaml").likelihood_weight
