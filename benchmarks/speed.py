"""Time start, inference, judging, rollouts, the grid's backward pass, and training.

    python benchmarks/speed.py [--json]

All figures are measured in one run, on all cores of the machine, and printed with the load of the
machine, since other jobs may share it. With Stable-Baselines3 installed (`make benchmark`), the
same run also times its training and rollouts.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from swerve import PPO, Distilled, Grid, SoftValue, Task, grid, learn, sample
from swerve.cli.demo import FOLDER, PROBLEM
from swerve.problem.loading import load_problem
from swerve.sampling.one_task import MAX_CHUNK
from swerve.simulation.trajectory import rollout
from swerve.solvers.grid.grid import GridNominal
from swerve.solvers.trained.ppo import PPOTrainer
from swerve.solvers.trained.training import TrainedNominal

REPEATS = 5


def seconds(run: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the shortest of several wall times [s]."""
    best = float("inf")
    for _ in range(repeats):
        began = time.perf_counter()
        run()
        best = min(best, time.perf_counter() - began)
    return best


def start_up() -> dict[str, float]:
    """Time `import swerve`, beyond what Python itself takes to start [ms]."""

    def process(code: str) -> Callable[[], object]:
        return lambda: subprocess.run([sys.executable, "-c", code], check=True)

    bare = seconds(process("pass"), 10)
    return {"import swerve (ms)": 1e3 * (seconds(process("import swerve"), 10) - bare)}


def stored_inference() -> dict[str, float]:
    """Time `swerve infer` on stored evidence of the bundled demonstrations, process included."""
    files = sorted(FOLDER.glob("demo_*.csv"))
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "swerve", "infer", PROBLEM, *map(str, files)]
        command += ["--tasks", str(FOLDER / "tasks.csv"), "--work", folder, "--json"]
        solver = ["--solver", "grid?num_points=40"]

        def infer(*more: str) -> None:
            subprocess.run([*command, *more], capture_output=True, check=True)

        infer(*solver, "--samples", "10000")
        best = seconds(infer)
    return {f"swerve infer, {len(files)} stored tasks (s)": best}


def judging() -> dict[str, float]:
    """Time finding the cells that trajectories enter, for few and for many cells."""
    problem = load_problem(PROBLEM)
    space = problem.mdp.space
    generator = np.random.default_rng(0)
    omega = np.cumsum(generator.normal(size=(1000, 301)) * 0.1, axis=1)
    theta = np.cumsum(omega / 60.0, axis=1)
    states = np.stack([theta, omega], axis=-1)
    figures = {}
    for cells in (10, 1000):
        hypotheses = grid(theta=(0.0, 2 * np.pi, cells), omega=(-6.0, 6.0, cells))
        for between in (False, True):
            best = seconds(lambda h=hypotheses, b=between: h.violations(states, space, b), 3)
            where = "and between" if between else "alone"
            figures[f"judging, {cells**2} cells, states {where} (us/trajectory)"] = 1e3 * best
    return figures


def backward_pass() -> dict[str, float]:
    """Time the grid solver's backward pass for one goal and for eight [s a goal]."""
    nominal = learn(load_problem(PROBLEM), Grid())
    assert isinstance(nominal, GridNominal)
    goals = np.random.default_rng(0).uniform([0.0, -2.0], [6.0, 2.0], (8, 2))
    nominal.backward(goals[:1])
    return {
        "grid backward pass, 1 goal [s]": seconds(lambda: nominal.backward(goals[:1]), 2),
        "grid backward pass, 8 goals [s/goal]": seconds(lambda: nominal.backward(goals), 1) / 8,
    }


def untrained() -> dict[str, TrainedNominal]:
    """Return networks that are hardly trained; they are as fast as trained ones."""
    problem = load_problem(PROBLEM)
    sizes = {"num_steps": 1, "num_lanes": 8, "segment": 8}
    soft_value = SoftValue(**sizes).learn(problem)
    return {
        "PPO": PPO(**sizes).learn(problem),
        "soft value, look-ahead": soft_value,
        "soft value, distilled": Distilled(**sizes).imitate(soft_value),
    }


def rollouts() -> dict[str, float]:
    """Time rollouts of each kind of policy, on all cores [steps/s]."""
    problem = load_problem(PROBLEM)
    workers = len(os.sched_getaffinity(0))
    start, goal = jnp.array([1.0, 0.5]), jnp.array([3.0, 0.0])
    policies = {name: nominal.policy for name, nominal in untrained().items()}
    policies["grid"] = next(Grid().learn(problem).policies(np.asarray(goal)[None]))
    figures = {}
    for name, policy in policies.items():
        chunks = 32 if name in ("PPO", "soft value, distilled") else 4

        def one(seed: int, policy: Any = policy) -> None:
            found = rollout(problem, policy, start, goal, jax.random.key(seed), MAX_CHUNK)
            jax.block_until_ready(found.total_reward)

        one(0)
        with ThreadPoolExecutor(workers) as pool:
            best = seconds(lambda c=chunks, o=one: list(pool.map(o, range(c))), 3)
        figures[f"rollouts, {name} (steps/s)"] = chunks * MAX_CHUNK * 300 / best
    return figures


def new_task() -> dict[str, float]:
    """Time 10,000 judged trajectories of one more task, network given and compiled [s]."""
    task = Task([1.0, 0.5], [3.0, 0.0])
    figures = {}
    for name, nominal in untrained().items():
        if name == "PPO":
            continue
        sample(nominal, task, 10_000, method="smc")
        best = seconds(lambda n=nominal: sample(n, task, 10_000, method="smc", seed=1), 3)
        figures[f"10,000 trajectories of a task by SMC, {name} (s)"] = best
    return figures


def training() -> dict[str, float]:
    """Time PPO with its default settings, learning included [steps/s]."""
    settings = PPO(num_steps=20_000_000)
    trainer = PPOTrainer(load_problem(PROBLEM), settings, 0)
    iterations = settings.chunk_iterations
    state, _ = jax.block_until_ready(trainer.run(trainer.initial_state(), iterations))
    best = seconds(lambda: jax.block_until_ready(trainer.run(state, iterations)), 4)
    return {"PPO, learning included (steps/s)": settings.chunk_steps / best}


def stable_baselines() -> dict[str, float]:
    """Time Stable-Baselines3 at the same job, if it is installed [steps/s]."""
    if importlib.util.find_spec("stable_baselines3") is None:
        return {}
    sys.path.insert(0, str(Path(__file__).parent))
    from stable_baselines import measure

    result = measure()
    return {
        "Stable-Baselines3 PPO, 8 environments (steps/s)": result["training_steps_per_second"],
        "Stable-Baselines3 rollouts, 100 environments (steps/s)": result[
            "rollout_steps_per_second"
        ],
    }


def main() -> None:
    """Measure everything and print one table."""
    parser = argparse.ArgumentParser(description="Speed of everything that users wait for.")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    measures = (
        start_up,
        stored_inference,
        judging,
        backward_pass,
        rollouts,
        new_task,
        training,
        stable_baselines,
    )
    figures: dict[str, float] = {}
    loads = []
    for measure in measures:
        print(f"measuring {measure.__name__} ...", file=sys.stderr)
        figures |= measure()
        loads.append(os.getloadavg()[0])
    figures |= {"cores": os.cpu_count() or 0, "load average, highest": max(loads)}
    if arguments.json:
        print(json.dumps(figures))
        return
    table = Table("figure", "value", title="speed")
    for name, value in figures.items():
        table.add_row(name, f"{value:,.3g}" if value < 1000 else f"{value:,.0f}")
    Console().print(table)


if __name__ == "__main__":
    main()
