"""What each option of `swerve demonstrate` does to the demonstrations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from support.command import CONSTRAINT, SPACE, Run

from swerve.constraints.base import violates
from swerve.demonstrations.demonstration import Demonstration, read_demonstrations
from swerve.systems.gridworld import Gridworld

WORLD = "gridworld?width=4&height=3&num_steps=6"
ACROSS = "demo,start_theta,start_omega,goal_theta,goal_omega\n0,5,0,5.5,0\n"


def made(folder: Path) -> list[Demonstration]:
    """Return the demonstrations in a folder, with their torques."""
    files = sorted(folder.glob("demo_*.csv"))
    return read_demonstrations(files, SPACE, action_names=("torque",))


def test_boltzmann(run: Run, robot: str, tmp_path: Path) -> None:
    """The index, the number, the seed and the solver each change what is made."""
    hypotheses, space = Gridworld(4, 3, 6).hypotheses(), Gridworld(4, 3, 6).space
    found = {}
    for name, index, more in (
        ("usual", 5, ("--num", 20)),
        ("other", 6, ("--num", 20)),
        ("seed", 5, ("--num", 20, "--seed", 1)),
        ("solver", 5, ("--num", 3, "--solver", "tabular")),
    ):
        out = tmp_path / name
        status, _, said = run("demonstrate", WORLD, "--constraint", index, "--out", out, *more)
        assert status == 0, said
        assert (out / "tasks.csv").exists()
        found[name] = read_demonstrations(sorted(out.glob("demo_*.csv")), space)
    assert [len(items) for items in found.values()] == [20, 20, 20, 3]
    for index, avoiding, entering in ((5, "usual", "other"), (6, "other", "usual")):
        inside = {
            name: [violates(hypotheses[index], item.states, space, False) for item in found[name]]
            for name in (avoiding, entering)
        }
        assert not any(inside[avoiding])
        assert any(inside[entering])
    paths = [[item.states.tolist() for item in found[name]] for name in ("usual", "seed")]
    assert paths[0] != paths[1]
    words = ("--constraint", 5, "--out", tmp_path / "none", "--solver", "tabular")
    status, _, said = run("demonstrate", robot, *words)
    assert status == 1
    assert "the tabular solver needs a tabular MDP" in said


def test_optimal_control(robot: str, run: Run, tmp_path: Path) -> None:
    """By other actions than the MDP's, in other numbers of steps, to another distance."""
    (tmp_path / "tasks.csv").write_text(ACROSS)
    words = ("demonstrate", robot, "--constraint", CONSTRAINT, "--tasks", tmp_path / "tasks.csv")
    words = (*words, "--by", "optimal-control")
    found = {}
    for name, more in {
        "usual": (),
        "weak": ("--max-action", 1.5),
        "short": ("--num-steps", 4),
    }.items():
        status, _, said = run(*words, *more, "--out", tmp_path / name)
        assert status == 0, said
        (found[name],) = made(tmp_path / name)
    lengths = {name: len(item.states) for name, item in found.items()}
    assert lengths == {"usual": 7, "weak": 7, "short": 5}
    torques = {name: np.nanmax(np.abs(item.actions)) for name, item in found.items()}
    assert torques["weak"] <= 1.5 + 1e-6 < torques["usual"]
    idle = (*words, "--max-action", 0.01, "--out", tmp_path / "idle")
    assert run(*idle)[0] == 1  # nobody gets there without a push
    assert run(*idle, "--goal-tolerance", 10)[0] == 0
    (found,) = made(tmp_path / "idle")
    assert np.linalg.norm(found.states[-1] - [5.5, 0.0]) > 0.05
