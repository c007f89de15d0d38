"""Fixtures for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

# CI judges a change, not its luck: there the examples are always the same ones.
settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    settings.load_profile("ci")


@pytest.fixture(scope="session")
def test_data() -> Path:
    """Folder of real data, from $HBBATCH_TEST_DATA; needed in CI, optional elsewhere."""
    root = Path(__file__).parents[1]
    folder = (root / os.environ.get("HBBATCH_TEST_DATA", "../shared/data")).resolve()
    if not folder.is_dir():
        message = f"no test data in {folder}; set HBBATCH_TEST_DATA"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return folder
