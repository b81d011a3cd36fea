"""Files that others may have made are opened only if they are regular."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from swerve.base.files import open_regular


def test_a_regular_file_or_a_link_to_one_is_opened(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"abc")
    (tmp_path / "link").symlink_to(path)
    for name in ("a", "link"):
        with open_regular(tmp_path / name) as file:
            assert file.read() == b"abc"


def test_pipes_devices_and_folders_are_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/zero")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path / "link"):
        with pytest.raises(OSError, match=f"{path}: expected a file, got a (pipe|device)"):
            open_regular(path)
    with pytest.raises(OSError, match="expected a regular file, got a folder"):
        open_regular(tmp_path)
