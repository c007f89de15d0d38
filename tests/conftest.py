"""Fixtures for all tests."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import settings

from hbbatch.packed.kernels import AVAILABLE

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


@pytest.fixture(scope="session")
def kernels() -> ModuleType:
    """The compiled kernels; needed in CI, elsewhere tests of them are skipped without."""
    if not AVAILABLE:
        message = "the kernels are not compiled; install with a C compiler"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return import_module("hbbatch.packed._kernels")
