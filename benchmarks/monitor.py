"""Time one state of a monitor, and measure whether `swerve watch` keeps up.

    python benchmarks/monitor.py [--hypotheses 100,10000] [--states N] [--watch SECONDS]

A monitor observes a random path of a pendulum state by state, with a network of random weights,
which takes as long as a trained one. Input checks and the posterior are included. Pin the process
to a core that nothing else uses (`taskset -c 1`). A loop of plain NumPy calls is timed after each
state, to compare machines, and to see how far the machine itself delays the slowest state in a
thousand. With --watch SECONDS, `swerve watch` gets a state every millisecond for that time, and the
delay of its answers is printed.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from swerve.base.space import TWO_PI, StateSpace, Task
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import Samples, summarise
from swerve.hypotheses.bits import pack
from swerve.hypotheses.grid import grid
from swerve.monitoring.foresight import Foresight, Inputs, hidden_sizes
from swerve.monitoring.monitor import Monitor
from swerve.problem.record import ProblemRecord

WARM_UP = 1000
QUANTILES = (0.5, 0.99, 0.999)
NUM_CALLS = 50  # NumPy calls of the loop timed after each state
NUM_SAMPLES = 200
TASK = Task(np.array([3.0, 0.0]), np.array([1.0, 0.5]))
TASKS = Task(*(part[None] for part in TASK))


def make_evidence(num_hypotheses: int, tasks: Task) -> Evidence:
    """Return evidence of a square grid of hypotheses for tasks [K]."""
    side = math.isqrt(num_hypotheses)
    space = StateSpace(("theta", "omega"), ("theta",), np.array([[0.0, TWO_PI], [-8.0, 8.0]]))
    record = ProblemRecord(
        name="Pendulum",
        space=space,
        action_names=("torque",),
        goal_names=space.names,
        goal_is_last_state=True,
        num_actions=5,
        num_steps=300,
        dt=1.0 / 60.0,
        hypotheses=grid(theta=(0.0, TWO_PI, side), omega=(-6.0, 6.0, side)),
        known=(),
        beta=0.67,
        measure="uniform",
        between_states=True,
        mdp_digest="",
    )
    generator = np.random.default_rng(0)
    shape = len(tasks.start), NUM_SAMPLES
    chance = generator.random(side**2)
    samples = Samples(
        total_reward=np.zeros(shape),
        log_probability=np.zeros(shape),
        length=np.full(shape, 300),
        log_correction=np.zeros(shape),
        ancestor=np.broadcast_to(np.arange(NUM_SAMPLES), shape),
        violations=pack(generator.random((*shape, side**2)) < chance),
        kept=generator.normal(size=(shape[0], 4, 301, 2)),
        soft_value=np.full(shape[0], np.nan),
    )
    summary = summarise(record, samples, "plain")
    return Evidence(record, tasks, "plain", NUM_SAMPLES, "", 0, summary, lambda: samples)


def make_foresight(evidence: Evidence) -> Foresight:
    """Return a network of random weights for all tasks of the evidence."""
    record, goals, generator = evidence.problem, evidence.tasks.goal, np.random.default_rng(0)
    num_hypotheses = len(record.hypotheses)
    inputs = Inputs(record.space, True, np.zeros(2), np.ones(2), record.num_steps)
    num_inputs = len(inputs(evidence.tasks.start[0], np.asarray(0.0), goals[0]))
    sizes = (num_inputs, *hidden_sizes(num_hypotheses), num_hypotheses)
    weights = [
        generator.normal(size=(outputs, before)).astype(np.float32) / before**0.5
        for before, outputs in itertools.pairwise(sizes)
    ]
    biases = [np.zeros(len(weight), np.float32) for weight in weights]
    return Foresight(
        record.fingerprint, evidence.digest, inputs, goals, tuple(weights), tuple(biases)
    )


def path(num_states: int, seed: int = 1) -> np.ndarray:
    """Return states [L, 2] of a pendulum under random torques."""
    generator, dt = np.random.default_rng(seed), 1.0 / 60.0
    states = np.empty((num_states, 2))
    theta, omega = 3.0, 0.0
    for k in range(num_states):
        states[k] = theta, omega
        omega += dt * (math.sin(theta) - 0.3 * omega + 8.0 * generator.normal())
        theta += dt * omega
    return states


def observe_times(num_hypotheses: int, num_states: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the time of each state [s], and that of NUM_CALLS plain NumPy calls after it.

    The states are of demonstrations of 300 steps, one after another.
    """
    evidence = make_evidence(num_hypotheses, TASKS)
    foresight, states, values = make_foresight(evidence), path(300), np.zeros(100, np.float32)
    seconds = np.empty((2, num_states))
    for first in range(0, num_states, 300):
        monitor = Monitor(evidence, TASK, foresight)
        for k, state in enumerate(states[: num_states - first]):
            began = time.perf_counter()
            monitor.observe(state, k / 60.0)
            seconds[0, first + k] = time.perf_counter() - began
            began = time.perf_counter()
            for _ in range(NUM_CALLS):
                np.add(values, 1.0, out=values)
            seconds[1, first + k] = time.perf_counter() - began
    return seconds[0, WARM_UP:], seconds[1, WARM_UP:]


def lateness(seconds: float) -> np.ndarray:
    """Return the delay of each answer of `swerve watch` [s], for a state every millisecond."""
    evidence = make_evidence(100, TASKS)
    foresight = make_foresight(evidence)
    states, num = path(300), int(seconds * 1000)
    with tempfile.TemporaryDirectory() as folder:
        evidence.save(Path(folder) / "a.evidence")
        foresight.save(Path(folder) / "a.foresight")
        code = (
            "import sys; from pathlib import Path; from swerve.evidence.evidence import Evidence\n"
            "from swerve.monitoring.foresight import Foresight\n"
            "from swerve.base.space import Task\n"
            "from swerve.cli.json_lines import Watch, answer_lines\n"
            f"evidence = Evidence.load({str(Path(folder) / 'a.evidence')!r})\n"
            f"found = Foresight.load({str(Path(folder) / 'a.foresight')!r}, evidence.problem)\n"
            "task = Task(evidence.tasks.start[0], evidence.tasks.goal[0])\n"
            "answer_lines(sys.stdin.buffer, Watch(evidence, found, {'a': task}).answer, sys.stdout)"
        )
        with subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            answered = np.empty(num)
            lines = process.stdout

            def listen() -> None:
                for k in range(num):
                    assert "error" not in json.loads(lines.readline())
                    answered[k] = time.perf_counter()

            process.stdin.write("[3.0, 0.0]\n")  # its answer comes after the start of the process
            process.stdin.flush()
            lines.readline()
            thread = threading.Thread(target=listen)
            thread.start()
            sent, began = np.empty(num), time.perf_counter()
            for k in range(num):
                time.sleep(max(0.0, began + k * 1e-3 - time.perf_counter()))
                sent[k] = began + k * 1e-3
                state = states[k % 300].tolist()
                process.stdin.write(json.dumps({"theta": state[0], "omega": state[1]}) + "\n")
                process.stdin.flush()
            thread.join()
            process.stdin.close()
    return answered - sent


def main() -> None:
    """Time a monitor and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--hypotheses", default="100,10000")
    parser.add_argument("--states", type=int, default=20_000)
    parser.add_argument("--watch", type=float, default=0.0, help="seconds of `swerve watch`")
    arguments = parser.parse_args()
    title = f"Monitor.observe ({os.cpu_count()} cores, load {os.getloadavg()[0]:.1f})"
    table = Table(title=title)
    for column in ("hypotheses", *(f"{share:.1%} [us]" for share in QUANTILES)):
        table.add_column(column)
    for text in arguments.hypotheses.split(","):
        rows = (text, f"{NUM_CALLS} NumPy calls between them")
        for name, seconds in zip(rows, observe_times(int(text), arguments.states), strict=True):
            table.add_row(name, *(f"{1e6 * np.quantile(seconds, q):.1f}" for q in QUANTILES))
    console = Console(width=110)
    console.print(table)
    if arguments.watch:
        late = 1e3 * lateness(arguments.watch)
        console.print(
            f"swerve watch, {len(late)} states at 1 kHz: answers come "
            f"{np.median(late):.2f} ms late at the median, {np.quantile(late, 0.999):.1f} at the "
            f"99.9th percentile, {late[-100:].max():.1f} at the end"
        )


if __name__ == "__main__":
    main()
