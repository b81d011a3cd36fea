"""Problems and evidence made of numbers alone, where nothing has to be simulated."""

from __future__ import annotations

import numpy as np

from swerve.base.space import TWO_PI, StateSpace, Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import Samples, summarise
from swerve.hypotheses.base import HypothesisSet
from swerve.hypotheses.grid import grid
from swerve.problem.record import ProblemRecord

SPACE = StateSpace(("theta", "x"), ("theta",), np.array([[0.0, TWO_PI], [0.0, 10.0]]))
TASKS = Task(
    np.array([[0.1, 1.0], [3.0, 5.0], [6.0, 9.0]]), np.array([[1.0, 2.0], [2.0, 2.0], [0.2, 8.0]])
)


def make_record(**changes) -> ProblemRecord:
    """The record of a problem with 12 cells."""
    fields = {
        "name": "Toy(a=1)",
        "space": SPACE,
        "action_names": ("u",),
        "goal_names": ("theta", "x"),
        "goal_is_last_state": True,
        "num_actions": 3,
        "num_steps": 5,
        "dt": 0.1,
        "hypotheses": grid(theta=(0.0, TWO_PI, 4), x=(0.0, 9.0, 3)),
        "known": (),
        "beta": 0.5,
        "measure": "uniform",
        "between_states": False,
        "mdp_digest": "0123",
    }
    return ProblemRecord(**fields | changes)


def make_samples(
    num_trajectories: int = 400, tasks: Task = TASKS, num_hypotheses: int = 12, seed: int = 0
) -> Samples:
    """Samples of random weights; hypothesis h is entered more often than hypothesis h - 1."""
    generator = np.random.default_rng(seed)
    shape = (len(tasks.start), num_trajectories)
    chance = (np.arange(num_hypotheses) + 1.0) / (num_hypotheses + 1.0)
    violates = generator.random((*shape, num_hypotheses)) < chance
    return Samples(
        total_reward=generator.normal(-3.0, 0.5, shape),
        log_probability=generator.normal(-5.0, 0.3, shape),
        length=generator.integers(3, 6, shape),
        log_correction=np.zeros(shape),
        ancestor=np.broadcast_to(np.arange(num_trajectories), shape),
        violations=np.packbits(violates, axis=-1, bitorder="little"),
        kept=generator.normal(size=(shape[0], 4, 6, 2)),
        soft_value=np.full(shape[0], np.nan),
    )


def make_evidence(
    record: ProblemRecord | None = None,
    samples: Samples | None = None,
    tasks: Task = TASKS,
    method: str = "importance",
    **changes,
) -> Evidence:
    """Evidence of samples, summed up as sampling does; any demonstration looks like them."""
    record = make_record() if record is None else record
    if samples is None:
        samples = make_samples(tasks=tasks, num_hypotheses=len(record.hypotheses))
    fields = {
        "problem": record,
        "tasks": tasks,
        "method": method,
        "num_trajectories": samples.total_reward.shape[1],
        "solver": "Toy()",
        "seed": 0,
        "summary": summarise(record, samples, method)._replace(
            end_reach=np.full(tasks.start.shape, np.inf),
            shortest=np.zeros(len(tasks.start)),
            fastest=np.full(tasks.start.shape, np.inf),
        ),
        "load_samples": lambda: samples,
    }
    return Evidence(**fields | changes)


def evidence_of_columns(
    columns: np.ndarray, hypotheses: HypothesisSet, method: str = "plain", **changes
) -> Evidence:
    """Evidence of equal weights from violations [K, N, H]."""
    columns = np.asarray(columns, bool)
    shape = columns.shape[:2]
    samples = Samples(
        total_reward=np.zeros(shape),
        log_probability=np.zeros(shape),
        length=np.full(shape, 5),
        log_correction=np.zeros(shape),
        ancestor=np.broadcast_to(np.arange(shape[1]), shape),
        violations=np.packbits(columns, axis=-1, bitorder="little"),
        kept=np.zeros((shape[0], 2, 6, 2)),
        soft_value=np.full(shape[0], np.nan),
    )
    tasks = Task(TASKS.start[: shape[0]], TASKS.goal[: shape[0]])
    record = make_record(hypotheses=hypotheses)
    return make_evidence(record, samples, tasks, method, **changes)


def copied(seed: int, num_copies: int, method: str = "importance") -> Evidence:
    """Of 800 trajectories, `num_copies` share an ancestor; half enter 5, and 0.3 of them 7.

    They enter none of the other eight hypotheses.
    """
    generator = np.random.default_rng(seed)
    num = 800 // num_copies
    columns = np.zeros((1, num, 10), bool)
    columns[0, :, 5], columns[0, :, 7] = generator.random((2, num)) < [[0.5], [0.3]]
    columns = columns.repeat(num_copies, axis=1)
    evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)), method)
    ancestor = np.arange(800)[None] // num_copies * num_copies
    samples = evidence.samples._replace(ancestor=ancestor)
    return make_evidence(evidence.problem, samples, evidence.tasks, method)


def make_demonstration(
    task: int = 0, name: str = "demo", x: float | None = None, num_states: int = 5
) -> Demonstration:
    """A demonstration of one of TASKS that stays near its start, after it has been at `x`."""
    start, goal = TASKS.start[task], TASKS.goal[task]
    states = np.repeat(start[None], num_states, axis=0)
    states[-1, 0] += 0.01
    if x is not None:
        states[1, 1] = x
    return Demonstration(name, states, Task(start, goal))
