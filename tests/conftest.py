"""What all tests share."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

settings.register_profile("swerve", deadline=None)  # no test may fail for being slow
settings.load_profile("swerve")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real data beside the repository; in CI its absence is a failure."""
    if not SHARED_DATA.is_dir():
        reason = f"needs the real data, expected in {SHARED_DATA}"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    return SHARED_DATA
