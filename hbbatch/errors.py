"""Every error hbbatch raises on purpose, and the exit status each maps to.

    HbbatchError                 1   something asked for could not be done
    ├── UsageError               2   the command line or a config file asks for something impossible
    │   └── ConfigError          2   a YAML file or option value does not validate
    ├── SourceError              1   a log or folder given to `ingest` cannot be read
    │   └── SourceChoiceError    2   a source, or what the options choose in it, is not there
    ├── DatasetError             1   a dataset folder is missing, unreadable, unwritable or too new
    ├── SequenceError            1   one sequence failed; the others go on
    ├── WeightsError             2   weights asked for are missing, damaged or do not fit
    └── MissingExtraError        1   an optional dependency is not installed

A message names the file, sequence or topic, says what was wrong, and ends with what to do.
Exit status 3 (finished, with data lost) is no error but an outcome: see `ExitStatus`.
"""

from __future__ import annotations

import os
import traceback
from collections.abc import Iterable
from enum import IntEnum
from typing import Final

TRACEBACK_VARIABLE: Final = "HBBATCH_TRACEBACK"
"""Set by `hbbatch --traceback`, and by the environment of worker processes."""


class ExitStatus(IntEnum):
    """What the process tells the shell; the same four values as the `mcap` command line."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    DATA_LOSS = 3


class HbbatchError(Exception):
    """Base of all errors raised on purpose; its text is shown to the user as one line."""

    exit_status: ExitStatus = ExitStatus.FAILED


class UsageError(HbbatchError):
    """The command line asks for something that does not exist or does not fit together."""

    exit_status = ExitStatus.USAGE


class ConfigError(UsageError):
    """A configuration file or value does not validate."""


class SourceError(HbbatchError):
    """A log or folder given to `ingest` cannot be read."""


class SourceChoiceError(SourceError):
    """A source named does not exist, or the options choose something that is not in it."""

    exit_status = ExitStatus.USAGE


class DatasetError(HbbatchError):
    """A dataset folder is missing, unreadable, unwritable or written by a newer version."""


class SequenceError(HbbatchError):
    """One sequence could not be processed; other sequences are not affected."""


class WeightsError(HbbatchError):
    """Weights asked for are missing, damaged or made for another filter."""

    exit_status = ExitStatus.USAGE


class MissingExtraError(HbbatchError):
    """An optional dependency is needed and not installed."""


def report_defect(error: Exception) -> str:
    """What to say of an error not raised on purpose; its traceback is printed if asked for."""
    if os.environ.get(TRACEBACK_VARIABLE):
        traceback.print_exception(error)
    hint = "This is a defect of hbbatch; `hbbatch --traceback ...` shows where."
    return f"{type(error).__name__}: {error}. {hint}"


def status_of(errors: Iterable[HbbatchError]) -> ExitStatus:
    """What several errors, one at least, tell the shell: USAGE only if it is that of all."""
    return (
        ExitStatus.USAGE
        if {e.exit_status for e in errors} == {ExitStatus.USAGE}
        else ExitStatus.FAILED
    )
