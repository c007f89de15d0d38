"""Every error hbbatch raises on purpose, and the exit status each maps to.

    HbbatchError                 1   something asked for could not be done
    ├── UsageError               2   the command line or a config file asks for something impossible
    │   └── ConfigError          2   a YAML file or option value does not validate
    ├── SourceError              1   a log or folder given to `ingest` cannot be read
    ├── DatasetError             1   a dataset folder is missing, unreadable, unwritable or too new
    ├── SequenceError            1   one sequence failed; the others go on
    ├── WeightsError             1   weights are missing, damaged or of another version
    └── MissingExtraError        1   an optional dependency is not installed

A message names the file, sequence or topic, says what was wrong, and ends with what to do.
Exit status 3 (finished, with data lost) is no error but an outcome: see `ExitStatus`.
"""

from __future__ import annotations

from enum import IntEnum


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


class DatasetError(HbbatchError):
    """A dataset folder is missing, unreadable, unwritable or written by a newer version."""


class SequenceError(HbbatchError):
    """One sequence could not be processed; other sequences are not affected."""


class WeightsError(HbbatchError):
    """Network weights are missing, damaged or made for another network."""


class MissingExtraError(HbbatchError):
    """An optional dependency is needed and not installed."""
