"""What tests of problems share."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.problem_files import HELPER, ROBOT, SHAPES


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a problem that imports its neighbours; imports are forgotten afterwards."""
    for name, text in {"robot": ROBOT, "helper": HELPER, "shapes": SHAPES}.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    known = set(sys.modules)
    yield tmp_path
    for name, module in list(sys.modules.items()):
        if name not in known and str(tmp_path) in str(getattr(module, "__file__", "")):
            del sys.modules[name]
