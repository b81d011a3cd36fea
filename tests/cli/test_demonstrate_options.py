"""What each option of `swerve demonstrate` does to the demonstrations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from support.command import CONSTRAINT, SPACE, Run

from swerve.base.space import TWO_PI
from swerve.constraints.base import violates
from swerve.demonstrations.demonstration import Demonstration, read_demonstrations
from swerve.hypotheses.grid import grid

ACROSS = "demo,start_theta,start_omega,goal_theta,goal_omega\n0,5,0,5.5,0\n"


def made(folder: Path) -> list[Demonstration]:
    """Return the demonstrations in a folder, with their torques."""
    files = sorted(folder.glob("demo_*.csv"))
    return read_demonstrations(files, SPACE, action_names=("torque",))


def test_boltzmann(robot: str, run: Run, tmp_path: Path) -> None:
    """The index, the number, the seed and the solver's settings each change what is made."""
    (tmp_path / "tasks.csv").write_text(ACROSS)
    tasks = ("--tasks", tmp_path / "tasks.csv")
    found = {}
    for name, words in {
        "usual": ("--constraint", CONSTRAINT, *tasks, "--solver", "grid?num_points=20"),
        "seed": ("--constraint", CONSTRAINT, *tasks, "--solver", "grid?num_points=20", "--seed", 1),
        "solver": ("--constraint", CONSTRAINT, *tasks, "--solver", "grid?num_points=31"),
        "number": ("--constraint", 12, "--num", 3, "--solver", "grid?num_points=20"),
    }.items():
        status, _, said = run("demonstrate", robot, *words, "--out", tmp_path / name)
        assert status == 0, said
        found[name] = made(tmp_path / name)
        assert (tmp_path / name / "tasks.csv").exists()
    assert {name: len(items) for name, items in found.items()} == {
        **dict.fromkeys(("usual", "seed", "solver"), 1),
        "number": 3,
    }
    for name in ("seed", "solver"):
        assert not np.array_equal(found[name][0].states, found["usual"][0].states)
    hypotheses = grid(theta=(0.0, TWO_PI, 6), omega=(-4.0, 4.0, 5))
    for name, index in (("usual", CONSTRAINT), ("number", 12)):
        for item in found[name]:
            assert not violates(hypotheses.constraint(index), item.states, SPACE, True)


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
        "near": ("--goal-tolerance", 0.5),
    }.items():
        status, _, said = run(*words, *more, "--out", tmp_path / name)
        assert status == 0, said
        (found[name],) = made(tmp_path / name)
    lengths = {name: len(item.states) for name, item in found.items()}
    assert lengths == {"usual": 7, "weak": 7, "short": 5, "near": 7}
    torques = {name: np.nanmax(np.abs(item.actions)) for name, item in found.items()}
    assert torques["weak"] <= 1.5 + 1e-6 < torques["usual"]
    missed = {
        name: float(np.linalg.norm(item.states[-1] - [5.5, 0.0])) for name, item in found.items()
    }
    assert missed["usual"] <= 0.05 + 1e-6 < missed["near"] <= 0.5 + 1e-6
