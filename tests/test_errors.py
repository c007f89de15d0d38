"""The tree of errors."""

from __future__ import annotations

import inspect
import pickle
import re

import pytest

from hbbatch import errors
from hbbatch.errors import ExitStatus, HbbatchError

CLASSES = [
    value
    for _, value in inspect.getmembers(errors, inspect.isclass)
    if issubclass(value, HbbatchError)
]


def test_the_tree_in_the_docstring_is_the_tree() -> None:
    drawn = dict(re.findall(r"([A-Z]\w+Error)\s+(\d)  ", str(errors.__doc__)))
    assert drawn == {cls.__name__: str(int(cls.exit_status)) for cls in CLASSES}


@pytest.mark.parametrize("cls", CLASSES)
def test_errors_cross_process_borders(cls: type[HbbatchError]) -> None:
    copy = pickle.loads(pickle.dumps(cls("a: wrong. Do this.")))  # noqa: S301 - made here
    assert type(copy) is cls
    assert str(copy) == "a: wrong. Do this."


def test_exit_statuses_are_those_documented() -> None:
    assert {status.name: int(status) for status in ExitStatus} == {
        "DONE": 0,
        "FAILED": 1,
        "USAGE": 2,
        "DATA_LOSS": 3,
    }
