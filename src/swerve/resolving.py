"""Near-certain violations: hypotheses that hardly any nominal trajectory avoids.

Where all samples enter c they only say that Z_c / Z_0 is small. What driving round c would cost is
then told with c in force: the solver adapts what it learned to pi_c, the MDP with c among the known
constraints, and sequential Monte Carlo with the adapted soft value gives Z_c,

    log(Z_c / Z_0) = log Z_c - log Z_0,

however small. It is worked out for what matters: hypotheses that no demonstration enters and that
the samples leave open, in the tasks of the demonstrations.

Shapes: K tasks, H hypotheses, I islands.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from swerve.demonstrations import Demonstration
from swerve.estimators import NothingLeftError
from swerve.evidence import Evidence
from swerve.inference import infer
from swerve.nominal import Nominal, Solver
from swerve.problem import Problem
from swerve.progress import progress_bar
from swerve.samples import NUM_ISLANDS
from swerve.sampling import sample
from swerve.space import Task
from swerve.trust import LOW_ESS

NUM_TRAJECTORIES = 2_000  # a task and hypothesis
SETTLED = 0.15  # nats: standard error of a ratio that is taken


@runtime_checkable
class AdaptingSolver(Solver, Protocol):
    """A solver whose soft value can be adapted to more known constraints.

    Attributes:
      adapting_rounds: how often it is worth while to go on adapting.
    """

    adapting_rounds: int

    def adapt(self, nominal: Any, problem: Problem, seed: int) -> Nominal:
        """Return the nominal distribution of a problem with more known constraints."""
        ...


def resolve(
    nominal: Nominal,
    evidence: Evidence,
    demonstrations: Sequence[Demonstration],
    *,
    seed: int = 0,
    progress: bool = False,
    keep: Callable[[Evidence], None] = lambda evidence: None,
) -> Evidence:
    """Work out the ratios that evidence leaves open, for hypotheses that matter to the ranking.

    Args:
      nominal: what the evidence was sampled from.
      evidence: in which almost every trajectory enters some hypotheses.
      demonstrations: whose ranking is wanted; hypotheses that one of them enters are left out.
      seed: of everything random.
      progress: whether to show a progress bar.
      keep: called with what there is after each hypothesis, since all of them may take long.

    Returns:
      The evidence with numbers in place of bounds. The bound remains where even with c in force no
      trajectory avoids it, or not well enough known how many do.

    Raises:
      ValueError: if the nominal has no soft value, or is of another problem.
    """
    if not isinstance(nominal.solver, AdaptingSolver):
        raise ValueError(
            "nominal: expected one of a solver with a soft value that adapts (grid, soft-value), "
            f"got {nominal.solver.name!r}"
        )
    if nominal.problem.record.fingerprint != evidence.problem.fingerprint:
        raise ValueError(
            f"the evidence is of another problem, {evidence.problem.summary}, than the nominal, "
            f"{nominal.problem.record.summary}"
        )
    is_open = infer(evidence, demonstrations).is_open
    hypotheses = np.flatnonzero(is_open.any(axis=0)).tolist()
    with progress_bar("resolving", len(hypotheses), progress) as advance:
        for index in hypotheses:
            tasks = np.flatnonzero(is_open[:, index]).tolist()
            evidence = _resolved(nominal, evidence, index, tasks, seed)
            keep(evidence)
            advance(1)
    return evidence


def _resolved(
    nominal: Nominal, evidence: Evidence, index: int, tasks: list[int], seed: int
) -> Evidence:
    """Return evidence with the ratio of one hypothesis in some tasks, as far as it settles."""
    chosen = evidence.select(tasks)
    log_ratio, error = _ratio(nominal, chosen, index, seed)
    settled = np.isfinite(error)
    columns = {
        "avoid_probability": np.exp(log_ratio),
        "avoid_variance": (np.exp(log_ratio) * error) ** 2,
        "log_ratio": log_ratio,
        "log_ratio_error": error,
    }
    changed = {name: getattr(evidence.summary, name).copy() for name in columns}
    for name, values in columns.items():
        changed[name][np.array(tasks)[settled], index] = values[settled]
    changed["log_ratio_error"][tasks, index] = error
    return dataclasses.replace(evidence, summary=evidence.summary._replace(**changed))


def _ratio(
    nominal: Nominal, evidence: Evidence, index: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return log Z_c / Z_0 and its standard error [K] for all tasks of evidence, nats.

    The error is infinite where that did not settle it.
    """
    problem, solver = nominal.problem, nominal.solver
    assert isinstance(solver, AdaptingSolver)
    constraint = problem.hypotheses.constraint(index)
    narrower = dataclasses.replace(problem, known=[*problem.known, constraint])
    log_ratio, error = np.zeros(evidence.num_tasks), np.full(evidence.num_tasks, np.inf)
    own_error = evidence.island_spread / NUM_ISLANDS**0.5
    for number in range(solver.adapting_rounds):
        left = np.flatnonzero(np.isinf(error) & (own_error < SETTLED)).tolist()
        if not left:
            break
        nominal = solver.adapt(nominal, narrower, seed + number)
        for k in left:
            avoiding = _sampled(nominal, evidence.select([k]).tasks, seed)
            if avoiding is None:
                continue
            found = math.hypot(avoiding.island_spread[0] / NUM_ISLANDS**0.5, own_error[k])
            if found < SETTLED and avoiding.effective_sample_size[0] >= LOW_ESS:
                log_ratio[k] = avoiding.log_partition[0] - evidence.log_partition[k]
                error[k] = found
    return log_ratio, error


def _sampled(nominal: Nominal, task: Task, seed: int) -> Evidence | None:
    """Return evidence of one task, None where no trajectory is left."""
    try:
        return sample(nominal, task, NUM_TRAJECTORIES, method="smc", seed=seed)
    except NothingLeftError:
        return None
