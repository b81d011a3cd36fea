"""A stored file for the tests of this folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.stored_files import ARRAYS, HEADER, KIND, VERSION

from swerve.base import store


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "evidence.swerve"
    store.write(path, KIND, VERSION, HEADER, ARRAYS)
    return path
