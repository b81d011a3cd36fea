"""Every solver and everything that runs JAX, at the least size; `python every_solver.py` prints it.

The model computes with NumPy's float64 numbers, which JAX keeps where it was told to use 64 bits.
"""

from __future__ import annotations

import json
import sys
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import swerve
from swerve.fitting.rewards import total_rewards

TASK = swerve.Task([-0.5, 0.0], [0.5, 0.3])
GRID = "grid?num_points=8"
TINY = "num_steps=256&num_lanes=8&segment=4&num_minibatches=2&width=4"


class Push(swerve.MDP):
    """A mass on a line."""

    state_names = ("x", "v")
    action_names = ("force",)
    actions = np.linspace(-1.0, 1.0, 3)[:, None]
    bounds = ((-2.0, 2.0), (-3.0, 3.0))
    dt = np.float64(0.3)
    num_steps = 4

    def dynamics(self, state: Any, action: Any) -> Any:
        return jnp.stack([state[0] + self.dt * state[1], state[1] + self.dt * action[0]])

    def reward(self, state: Any, action: Any, next_state: Any, goal: Any) -> Any:
        return -np.float64(0.1) * action[0] ** 2

    def terminal_reward(self, state: Any, goal: Any) -> Any:
        return -np.float64(2.0) * jnp.sum((state - goal) ** 2)

    def terminated(self, state: Any, goal: Any) -> Any:
        return jnp.where(state[0] > 1.5, 1.0, 0.0)


def heavy(states: Any) -> Any:
    return states[..., 1] > np.float64(1.2)


def push(**settings: Any) -> swerve.Problem:
    """Return the problem, with hypotheses of three kinds."""
    hypotheses = [
        swerve.Box(x=(-0.1, 0.1)),
        swerve.Ball(0.5, x=0.0, v=1.0),
        swerve.Predicate("heavy", heavy),
    ]
    return swerve.Problem(Push(), hypotheses, beta=np.float64(1.0), **settings)


def sampled() -> dict[str, np.ndarray]:
    """Return what the grid's samples give; the same numbers whatever the precision."""
    problem = push(known=[swerve.Ball(0.3, x=1.0, v=0.0)])
    nominal: Any = swerve.learn(problem, GRID)
    found = {}
    for method in ("smc", "importance", "plain"):
        evidence = swerve.sample(nominal, TASK, 200, method=method)
        found[method] = np.append(evidence.violation_probability, evidence.log_partition)
    tempered = swerve.sample(nominal, TASK, 200, beta=1.4)
    evidence = swerve.sample(nominal, TASK, 200)
    made = swerve.demonstrate(problem, swerve.Box(x=(-1.9, -1.5)), [TASK] * 6, nominal=nominal)
    foresight = swerve.foresee(nominal, evidence, num_trajectories=256, num_updates=10)
    start, goal = (np.array(values) for values in TASK)
    return found | {
        "tempered": tempered.log_partition,
        "resolved": swerve.resolve(nominal, swerve.infer(evidence)).log_ratio,
        "demonstrated": np.concatenate([one.states for one in made]),
        "rewards": total_rewards(problem, made),
        "divergence": np.array(swerve.divergence(problem, made, np.zeros(6))),
        "foreseen": foresight.towards(goal)(start, 0),
        "rolled out": swerve.Rollouts(nominal, 50).towards(goal)(start, 1),
        "tasks": np.concatenate(swerve.draw_tasks(problem, 3)),
    }


def solved() -> dict[str, np.ndarray]:
    """Return log Z_0 and the violation probabilities by every other solver."""
    world = swerve.Gridworld(3, 3, 12)
    cells = swerve.Problem(world, world.hypotheses(), beta=3.0, measure="counting")
    corner = swerve.Task([0, 0], [2, 2])
    cases = {
        "enumeration": (push(), "enumeration", TASK),
        "discrete": (push(), "discrete?num_cells=9", TASK),
        "ppo": (push(), f"ppo?{TINY}", TASK),
        "soft-value": (push(), f"soft-value?{TINY}", TASK),
        "distilled": (push(), None, TASK),
        "tabular": (cells, "tabular", corner),
        "soft-paths": (cells, "soft-paths?", corner),
    }
    found, nominals = {}, {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # so short a training comes no nearer
        for name, (problem, solver, task) in cases.items():
            if solver is None:
                settings = {"num_steps": 256, "num_lanes": 8, "segment": 4, "width": 4}
                student = swerve.Distilled(num_minibatches=2, **settings)
                nominal: Any = student.imitate(nominals["soft-value"])
            else:
                nominal = swerve.learn(problem, solver)
            nominals[name] = nominal
            evidence = swerve.sample(nominal, task, 2000)
            found[name] = np.append(evidence.violation_probability, evidence.log_partition)
    return found


if __name__ == "__main__":
    assert jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]
    answers = {name: np.asarray(x).tolist() for name, x in (sampled() | solved()).items()}
    json.dump(answers, sys.stdout)
