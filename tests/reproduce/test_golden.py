"""Comparison with golden output notices altered output."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command import Run
from support.golden_world import altered

from swerve.reproduce.gridworld import measure as gridworld
from swerve.reproduce.gridworld.golden import compare, read_golden

ROOT = Path(__file__).resolve().parents[2]


def alter_pick(data: dict[str, Any]) -> None:
    pick = data["sets"][0]["selected"][1][-1]
    pick.update(type="state", value=11 if pick["value"] != 11 else 10)


def alter_kl(data: dict[str, Any]) -> None:
    data["sets"][0]["selected"][2][0]["kl"] += 1e-6


def test_golden_output_is_told_from_altered_output(golden: Path, tmp_path: Path) -> None:
    same, number, error = compare(read_golden(golden))
    assert (same, number) == (3, 3)
    assert error < 1e-12
    same, number, error = compare(read_golden(altered(golden, tmp_path, alter_pick)))
    assert (same, number) == (2, 3)
    assert error < 1e-12
    same, number, error = compare(read_golden(altered(golden, tmp_path, alter_kl)))
    assert (same, number) == (3, 3)
    assert error == pytest.approx(1e-6, rel=1e-3)


@pytest.mark.parametrize(
    ("change", "status", "said"),
    [
        (lambda data: None, 0, "3 of 3 sequences"),
        (alter_pick, 1, "2 of 3 sequences"),
        (alter_kl, 1, "largest KL error 1e-06"),
    ],
)
def test_exit_status_of_the_comparison(
    golden: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    change: Callable[[dict[str, Any]], object],
    status: int,
    said: str,
) -> None:
    script = ROOT / "experiments" / "gridworld" / "golden.py"
    monkeypatch.setattr(sys, "argv", [str(script), str(altered(golden, tmp_path, change))])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(script), run_name="__main__")
    assert ended.value.code == status
    assert said in capsys.readouterr().out


def test_real_golden_output(shared_data: Path) -> None:
    world = read_golden(shared_data / "gridworld" / "golden.json")
    assert len(world.truth) == 9
    same, number, error = compare(gridworld.at_sizes(world, [10]))
    assert (same, number) == (5, 5)
    assert error < 1e-12
    result = gridworld.measure(gridworld.at_sizes(world, [2, 5]))
    assert result.agreement is not None
    assert result.agreement[:2] == (10, 10)
    assert result.agreement.error < 1e-12
    assert result.golden is not None
    place = result.curves.thresholds.index(0.1)
    np.testing.assert_array_equal(result.curves.num_false[place], result.golden.num_false[0])
    np.testing.assert_allclose(result.curves.kl[place], result.golden.kl[0], atol=1e-12)
    np.testing.assert_allclose(result.golden.num_false[0].mean(axis=0), [2.2, 1.2])


def test_command_refuses_before_the_work(run: Run, golden: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    cases: list[tuple[Callable[[dict[str, Any]], object], str]] = [
        (lambda data: data.pop("sets"), "not of the form of a golden.json: KeyError('sets')"),
        (lambda data: data.update(num_demonstrations=3), "not of the form of a golden.json"),
        (
            lambda data: data.update(num_demonstrations=[]),
            "numbers num_demonstrations of at least 1",
        ),
        (lambda data: data.update(sets=[]), "at least one set of demonstrations, got none"),
        (lambda data: data.update(num_demonstrations=[1, 3, 9]), "expected 9 demonstrations"),
        (lambda data: data["sets"][0]["selected"].pop(), "picks for each of 3 sizes, got 2"),
        (lambda data: data["sets"][0]["actions"][0].append(9), "not of the form of a golden.json"),
    ]
    for change, message in cases:
        path = altered(golden, tmp_path, change)
        status, printed, said = run("reproduce", "gridworld", "--out", tmp_path, "--data", path)
        assert (status, printed) == (1, ""), message
        assert message in said
        assert str(path) in said
    (tmp_path / "torn.json").write_text(golden.read_text()[:-20])
    for out, data, message in (
        ("out", "nowhere.json", "nowhere.json: no such file; check the path"),
        ("out", "torn.json", "torn.json: not of the form of a golden.json"),
        ("file/out", golden, "cannot write in"),
    ):
        arguments = ("--out", tmp_path / out, "--data", tmp_path / data)
        status, printed, said = run("reproduce", "gridworld", *arguments)
        assert (status, printed) == (1, "")
        assert message in said
        assert "picking" not in said
    status, _, said = run("reproduce", "atlantis", "--out", tmp_path)
    assert status != 0
    assert "gridworld" in said


def test_quick_needs_sizes_that_are_there(golden: Path, tmp_path: Path) -> None:
    path = altered(golden, tmp_path, lambda data: data.update(num_demonstrations=[2, 4, 5]))
    with pytest.raises(ValueError, match=r"expected some of \[2, 4, 5\], got none: leave out"):
        gridworld.reproduce(path, is_quick=True)
