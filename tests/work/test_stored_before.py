"""A work folder that was written before the library was put into packages is still used."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from support.command import Run

STORED = Path(__file__).parents[1] / "data" / "before_packages"
INFER = ("infer", "pendulum?max_torque=10", "--json")
SETTINGS = ("--solver", "grid?num_points=24", "--samples", 20)
SENTENCES = ("headline", "warnings", "verdict")  # keys whose texts may be worded anew


def without_sentences(data: Any) -> Any:
    """Return JSON data without the sentences: all numbers, names and settings."""
    if isinstance(data, dict):
        kept = {key: value for key, value in data.items() if key not in SENTENCES}
        return {key: without_sentences(value) for key, value in kept.items()}
    return [without_sentences(item) for item in data] if isinstance(data, list) else data


@pytest.mark.parametrize("settings", [(), SETTINGS], ids=["as recorded", "named"])
def test_an_old_work_folder_gives_the_same_answer_without_learning(
    run: Run, tmp_path: Path, settings: tuple[object, ...]
) -> None:
    work = tmp_path / "work"
    shutil.copytree(STORED / "work", work)
    before = {path.name: path.read_bytes() for path in work.iterdir()}
    options = ("--tasks", STORED / "tasks.csv", "--work", work)
    status, out, said = run(*INFER, *options, *settings)
    assert status == 0, said
    assert {path.name: path.read_bytes() for path in work.iterdir()} == before
    assert "anew" not in said
    assert "learning" not in said
    expected = json.loads((STORED / "work.json").read_text())
    assert without_sentences(json.loads(out)) == without_sentences(expected)


def test_an_old_nominal_distribution_is_used_for_new_tasks(run: Run, tmp_path: Path) -> None:
    work = tmp_path / "work"
    shutil.copytree(STORED / "work", work)
    [nominal] = work.glob("*.nominal")
    (tmp_path / "tasks.csv").write_text(
        "demo,start_theta,start_omega,goal_theta,goal_omega\na,0.5,0.0,3.0,0.0\nb,1.0,0.0,3.0,0.0\n"
    )
    status, out, said = run(*INFER, "--tasks", tmp_path / "tasks.csv", "--work", work)
    assert status == 0, said
    assert f"using {nominal}" in said
    assert "learning" not in said
    assert not (work / "outdated").exists()
    old = json.loads((STORED / "work.json").read_text())["diagnostics"][0]
    new = json.loads(out)["diagnostics"][0]
    for name in ("start", "log_partition", "effective_sample_size", "kl"):
        assert new[name] == old[name]
