"""`hbbatch weights` as it is typed."""

from __future__ import annotations

import json

from typer.testing import CliRunner

from hbbatch.cli.main import app
from hbbatch.model.weights_files import shipped_names


def test_everything_shipped_that_was_learned_is_listed_with_its_terms() -> None:
    text = CliRunner().invoke(app, ["weights", "list"]).stdout
    content = json.loads(CliRunner().invoke(app, ["weights", "list", "--json"]).stdout)
    assert set(content) == {*shipped_names(), "confidence"}
    for name, header in content.items():
        assert f"{name}\n" in text or f"{name} (" in text
        assert header["about"]["licence"] in text
    assert "non-commercial" in content["confidence"]["about"]["licence"]
