"""Time greedy selection at full size: 10,000 trajectories, 10,000 hypotheses, 33 tasks, ten picks.

    python benchmarks/greedy.py [--quick] [--json]

Importance-weighted evidence of two kinds is made up. In the first, smooth walks cross a grid of
100 x 100 cells and enter hypothesis c where they come within a cell of cell c, so that neighbours
overlap. In the second, all bits are independent and random, so that no pick says anything about the
next. The bits (412 MB) are in memory before the clock starts. Picks, gains and standard errors are
first compared with the plain algorithm, which weighs all trajectories anew after each pick, at the
size of --quick (1,000 x 1,000 x 5). The best pair is timed as well, among 1,000 hypotheses: bounds
rule out nearly all pairs of walks, and no pair of random bits.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import tracemalloc
from typing import NamedTuple

import numpy as np

from swerve import Demonstration, Evidence, Inference, Task, best_pair, greedy, grid, infer
from swerve.base.space import StateSpace
from swerve.evidence import estimators
from swerve.evidence.samples import Samples, summarise
from swerve.hypotheses.bits import enters_set, pack, pack_sets
from swerve.inference.greedy import TIED, Pick
from swerve.problem.record import ProblemRecord

NUM_PICKS = 10
NUM_STEPS = 120
EXTENT = 10.0


class Size(NamedTuple):
    """Size of the made-up evidence."""

    num_trajectories: int
    cells: tuple[int, int]
    num_tasks: int


FULL = Size(10_000, (100, 100), 33)
PAIRS = Size(10_000, (40, 25), 33)
SMALL = Size(1_000, (40, 25), 5)


def walks(size: Size, tasks: Task, generator: np.random.Generator) -> np.ndarray:
    """Return packed bits [K, N, B]: the cells that smooth walks from start to goal come near."""
    rows, columns = size.cells
    time_done = np.linspace(0.0, 1.0, NUM_STEPS)
    waves = np.sin(np.pi * np.arange(1, 6)[:, None] * time_done)  # 0 at both ends
    packed = []
    for start, goal in zip(*tasks, strict=True):
        swerves = generator.normal(size=(size.num_trajectories, 2, 5)) / np.arange(1, 6)
        path = start[:, None] + (goal - start)[:, None] * time_done + 3.0 * swerves @ waves
        inside = ((path > 0.0) & (path < EXTENT)).all(axis=1)
        x = np.clip(path[:, 0] * rows / EXTENT, 0, rows - 1).astype(int)
        y = np.clip(path[:, 1] * columns / EXTENT, 0, columns - 1).astype(int)
        visited = np.zeros((size.num_trajectories, rows, columns), bool)
        n = np.broadcast_to(np.arange(size.num_trajectories)[:, None], x.shape)
        visited[n[inside], x[inside], y[inside]] = True
        for axis in (1, 2):
            near = np.pad(visited, [(0, 0)] + [(int(k == axis),) * 2 for k in (1, 2)])
            length = visited.shape[axis]
            visited = np.any([near.take(range(k, k + length), axis=axis) for k in range(3)], axis=0)
        packed.append(pack(visited.reshape(size.num_trajectories, -1)))
    return np.stack(packed)


def random_bits(size: Size, generator: np.random.Generator) -> np.ndarray:
    """Return packed bits [K, N, B], each set independently with probability 1/4."""
    shape = size.num_tasks, size.num_trajectories, size.cells[0] * size.cells[1] // 8
    bits = generator.integers(0, 256, shape, np.uint8)
    bits &= generator.integers(0, 256, shape, np.uint8)
    return bits


def inference_of(size: Size, kind: str) -> Inference:
    """Return made-up evidence with a demonstration of each task that rests at its start."""
    generator = np.random.default_rng(1)
    tasks = Task(*(generator.uniform(0.5, EXTENT - 0.5, (size.num_tasks, 2)) for _ in range(2)))
    shape = size.num_tasks, size.num_trajectories
    samples = Samples(
        total_reward=generator.normal(-3.0, 0.7, shape),
        log_probability=np.zeros(shape),
        length=np.full(shape, NUM_STEPS),
        log_correction=np.zeros(shape),
        ancestor=np.broadcast_to(np.arange(shape[1]), shape),
        violations=walks(size, tasks, generator)
        if kind == "walks"
        else random_bits(size, generator),
        kept=np.zeros((size.num_tasks, 2, 3, 2)),
        soft_value=np.full(size.num_tasks, np.nan),
    )
    record = ProblemRecord(
        name="MadeUp()",
        space=StateSpace(("x", "y"), (), np.array([[0.0, EXTENT], [0.0, EXTENT]])),
        action_names=("u",),
        goal_names=("x", "y"),
        goal_is_last_state=True,
        num_actions=3,
        num_steps=NUM_STEPS,
        dt=0.1,
        hypotheses=grid(x=(0.0, EXTENT, size.cells[0]), y=(0.0, EXTENT, size.cells[1])),
        known=(),
        beta=1.0,
        measure="counting",
        between_states=False,
        mdp_digest="",
    )
    evidence = Evidence(
        problem=record,
        tasks=tasks,
        method="importance",
        num_trajectories=shape[1],
        solver="MadeUp()",
        seed=0,
        summary=summarise(record, samples, "importance"),
        load_samples=lambda: samples,
    )
    shown = [
        Demonstration(f"demo_{k}", np.repeat(task[0][None], 2, axis=0), Task(*task))
        for k, task in enumerate(zip(*tasks, strict=True))
    ]
    return infer(evidence, shown)


def plain(inference: Inference) -> list[tuple[int, float, float]]:
    """Return picks (hypothesis, gain, error), weighing all trajectories anew after each pick."""
    evidence, left = inference.evidence, ~inference.struck_out
    num_hypotheses, share = len(left), inference.task_counts / len(inference.demonstrations)
    picked: list[tuple[int, float, float]] = []
    for _ in range(NUM_PICKS):
        [members] = pack_sets([[index for index, _, _ in picked]], num_hypotheses)
        found = []
        for log_weight, bits in zip(evidence.log_weight, evidence.samples.violations, strict=True):
            clean = np.where(enters_set(bits, members), -np.inf, log_weight)
            if np.isneginf(clean).all():  # no trajectory avoids the picks
                nothing = np.zeros(num_hypotheses)
                found.append(estimators.LogRatio(nothing, nothing + np.inf))
                continue
            estimate = estimators.avoid_probability(clean, bits, num_hypotheses)
            resolution = 1.0 / estimators.effective_sample_size(clean)
            found.append(estimators.log_ratio(estimate, resolution))
        gain = np.where(left, -share @ np.array([ratio.value for ratio in found]), -np.inf)
        index = int(gain.argmax())
        if gain[index] < TIED:
            break
        error = share * [ratio.standard_error[index] for ratio in found]
        picked.append((index, float(gain[index]), float(np.linalg.norm(error))))
        left[index] = False
    return picked


def select(inference: Inference) -> list[Pick]:
    """Return the picks of greedy selection."""
    return greedy(inference, threshold=0.0, most=NUM_PICKS)


def check(inference: Inference) -> None:
    """Raise AssertionError where greedy selection differs from the plain algorithm."""
    found = [(p.hypothesis, p.gain, p.standard_error) for p in select(inference)]
    expected = plain(inference)
    assert [row[0] for row in found] == [row[0] for row in expected]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def time_of_pair(inference: Inference) -> float:
    """Return the processor time of the best pair [s]."""
    inference.evidence.samples.violations.sum(axis=2, dtype=np.int64)
    began = time.process_time()
    best_pair(inference)
    return time.process_time() - began


def measure(kind: str, size: Size) -> dict[str, float]:
    """Return time and memory of greedy selection, and the time of the best pair."""
    check(inference_of(SMALL, kind))
    inference = inference_of(size, kind)
    inference.evidence.samples.violations.sum(
        axis=2, dtype=np.int64
    )  # read into memory before the clock starts
    began, began_cpu = time.perf_counter(), time.process_time()
    picks = select(inference)
    elapsed, used = time.perf_counter() - began, time.process_time() - began_cpu
    again = infer(inference.evidence, inference.demonstrations)
    tracemalloc.start()
    select(again)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    pairs = inference_of(PAIRS if size == FULL else SMALL, kind)
    left = np.exp(picks[-1].log_partition - inference.evidence.log_partition)
    return {
        "bits (MB)": inference.evidence.samples.violations.nbytes / 1e6,
        "picks": len(picks),
        "weight left uncovered (mean)": float(left.mean()),
        "time (s)": elapsed,
        "processor time (s)": used,
        "peak memory beyond the bits (MB)": peak / 1e6,
        "best pair of 1,000, processor time (s)": time_of_pair(pairs),
    }


def main() -> None:
    """Measure both kinds of evidence and print the numbers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="the small size alone")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args()
    size = SMALL if arguments.quick else FULL
    found = {kind: measure(kind, size) for kind in ("walks", "random bits")}
    if arguments.json:
        print(json.dumps({"size": size._asdict(), "load": os.getloadavg()[0], **found}))
        return
    print(f"{size}; load of the machine {os.getloadavg()[0]:.1f}; the small size as the plain one")
    for kind, row in found.items():
        print(kind)
        for name, value in row.items():
            print(f"  {name:<40} {value:.3g}")


if __name__ == "__main__":
    main()
