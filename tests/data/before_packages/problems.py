"""The problems whose files were written before the library was put into packages."""

from __future__ import annotations

import math

import numpy as np

import swerve

SMALL = {"num_steps": 2_048, "num_lanes": 64, "segment": 8, "width": 8}
SOLVERS = {
    "grid": swerve.Grid(num_points=(24, 24)),
    "ppo": swerve.PPO(**SMALL),
    "soft-value": swerve.SoftValue(**SMALL),
    "distilled": swerve.Distilled(**SMALL),
    "enumeration": swerve.Enumeration(),
    "discrete": swerve.Discrete(num_cells=(12, 12)),
    "tabular": swerve.Tabular(),
    "soft-paths": swerve.SoftPaths(),
}
GOALS = {"tabular": ((1, 0), (2, 2)), "soft-paths": ((0.35, 0.4), (2.1, 1.4))}


def task_of(name: str) -> swerve.Task:
    """Return the task that a solver's files are of."""
    start, goal = GOALS.get(name, ((0.5, 0.0), (3.0, 0.0)))
    return swerve.Task.stack([swerve.Task(start, goal)])


def problem_of(name: str) -> swerve.Problem:
    """Return the problem that a solver's files are of: one of every kind of system."""
    if name == "tabular":
        return swerve.load_problem("gridworld?width=4&height=4&num_steps=6")
    if name == "soft-paths":
        walker = swerve.Walker(bounds=((-0.75, 2.75), (-0.75, 2.25)), num_steps=200)
        blocked = np.zeros((10, 10), bool)
        blocked[4:6, :4] = True
        walls = swerve.Occupancy("walls", blocked, (0.0, 0.0), 0.2)
        windows = swerve.windows(overlap=2, x=(0.0, 2.0, 0.75), y=(0.0, 1.5, 0.75))
        corner = swerve.Polygon([(2.0, 1.5), (2.6, 1.5), (2.0, 2.1)], ("x", "y"))
        known = [walls, corner]
        return swerve.Problem(walker, windows, beta=9.0, measure="counting", known=known)
    cells = swerve.grid(theta=(0.0, 2 * math.pi, 6), omega=(-4.0, 4.0, 5))
    regions = [cells.constraint(index) for index in range(len(cells))]
    known = [swerve.Ball(0.2, theta=5.5, omega=-3.0)] if name == "grid" else []
    if name == "enumeration":
        regions += [
            swerve.Union("both", regions[:2]),
            swerve.HalfSpace(3.0, omega=1.0),
            swerve.Ball(0.5, theta=1.0, omega=0.0),
            swerve.ActionBox(torque=(1.0, 4.0)),
            swerve.StateAction(swerve.Box(omega=(0.0, 2.0)), swerve.ActionBox(torque=(1.0, 4.0))),
        ]
    hypotheses = regions if name == "enumeration" else cells
    mdp = swerve.Pendulum(max_torque=3.0, dt=0.4, num_steps=6)
    return swerve.Problem(mdp, hypotheses, beta=0.05, known=known)
