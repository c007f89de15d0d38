"""Fixtures for all tests."""

from __future__ import annotations

import os
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

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


def compiled(name: str) -> ModuleType:
    """An extension; needed in CI, elsewhere tests of it are skipped without."""
    if find_spec(name) is None:
        message = f"{name} is not compiled; install with a C compiler"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return import_module(name)


@pytest.fixture(scope="session")
def kernels() -> ModuleType:
    """What a lock step does, compiled."""
    return compiled("hbbatch.packed._kernels")


@pytest.fixture(scope="session")
def cdr() -> ModuleType:
    """The walk over CDR messages, compiled."""
    return compiled("hbbatch.sources._cdr")
