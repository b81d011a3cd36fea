"""Make the files beside this one, as they were made before the library was put into packages.

    git checkout ccf7e95 && pip install . && python make.py FOLDER

They are of the problems in `problems.py`, and of one work folder of a shipped problem. The answers
expected from them were printed by the code that wrote them.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from problems import SOLVERS, problem_of, task_of

import swerve

INFER = ("pendulum?max_torque=10", "--solver", "grid?num_points=24", "--samples", "20")


def main(folder: Path) -> None:
    """Write all files into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    expected = {}
    for name, solver in SOLVERS.items():
        problem = problem_of(name)
        tasks = task_of(name)
        if isinstance(solver, swerve.Distilled):
            teacher = swerve.load_nominal(folder / "soft-value.nominal", problem)
            nominal = solver.imitate(teacher, tasks=tasks, seed=0)
        else:
            nominal = swerve.learn(problem, solver, tasks=tasks, seed=0)
        swerve.save_nominal(folder / f"{name}.nominal", nominal)
        evidence = swerve.sample(nominal, tasks, num_trajectories=20, seed=0)
        evidence.save(folder / f"{name}.evidence")
        fresh = swerve.infer(evidence).to_json()
        expected[name] = {
            "fingerprint": problem.record.fingerprint,
            "log_partition": np.asarray(evidence.log_partition).tolist(),
            "ranking": [row["index"] for row in fresh["ranking"]],
            "log_likelihood": [row["log_likelihood"] for row in fresh["ranking"]],
        }
        if name == "grid":
            swerve.foresee(nominal, evidence, seed=0).save(folder / f"{name}.foresight")
    (folder / "expected.json").write_text(json.dumps(expected, indent=1) + "\n")
    tasks = folder / "tasks.csv"
    tasks.write_text("demo,start_theta,start_omega,goal_theta,goal_omega\na,0.5,0.0,3.0,0.0\n")
    command = [sys.executable, "-m", "swerve", "infer", *INFER, "--tasks", str(tasks), "--json"]
    work = ["--work", str(folder / "work")]
    done = subprocess.run([*command, *work], check=True, capture_output=True, text=True)
    (folder / "work.json").write_text(json.dumps(json.loads(done.stdout), indent=1) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
