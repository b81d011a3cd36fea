"""`swerve fit-beta`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from support.command import SOLVER, Run, infer


def test_fit_beta(robot: str, run: Run, demonstrations: list[Path], tmp_path: Path) -> None:
    """With what `infer` has sampled; the demonstrators' beta is 0.05, the problem's."""
    assert run(*infer(robot, demonstrations, tmp_path / "work", "--solver", SOLVER))[0] == 0
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "work").iterdir()}
    _, *arguments = infer(robot, demonstrations, tmp_path / "work")
    status, out, _ = run("fit-beta", *arguments, "--json")
    assert status == 0
    answer = json.loads(out)
    assert answer["low"] < 0.05 < (answer["high"] or np.inf)
    status, out, _ = run("fit-beta", *arguments, "--confidence", 0.5)
    assert status == 0
    assert out.startswith("beta ")
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "work").iterdir()} == before
    status, _, said = run("fit-beta", robot)
    assert status == 1
    assert "give at least one demonstration" in said
