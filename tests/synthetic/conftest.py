"""One simulated drive for all tests of the room."""

from __future__ import annotations

import pytest

from hbbatch.synthetic.drive import Drive, simulate_drive
from hbbatch.synthetic.settings import DriveSettings


@pytest.fixture(scope="session")
def drive() -> Drive:
    return simulate_drive(DriveSettings(duration_s=15.0), seed=7)
