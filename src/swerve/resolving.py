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
from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from swerve.demonstrations import Demonstration
from swerve.evidence import Evidence
from swerve.inference import infer
from swerve.nominal import Nominal, Solver
from swerve.problem import Problem
from swerve.progress import progress_bar
from swerve.samples import NUM_ISLANDS
from swerve.sampling import sample

NUM_TRAJECTORIES = 2_000  # a task and hypothesis
MAX_ROUNDS = 5  # of adapting
SETTLED = 0.15  # nats: standard error of a ratio that is taken


@runtime_checkable
class AdaptingSolver(Solver, Protocol):
    """A solver whose soft value can be adapted to more known constraints."""

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
) -> Evidence:
    """Work out the ratios that evidence leaves open, for hypotheses that matter to the ranking.

    Args:
      nominal: what the evidence was sampled from.
      evidence: in which almost every trajectory enters some hypotheses.
      demonstrations: whose ranking is wanted; hypotheses that one of them enters are left out.
      seed: of everything random.
      progress: whether to show a progress bar.

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
            advance(1)
    return evidence


def _resolved(
    nominal: Nominal, evidence: Evidence, index: int, tasks: list[int], seed: int
) -> Evidence:
    """Return evidence with the ratio of one hypothesis in some tasks, as far as it settles."""
    chosen = evidence.select(tasks)
    log_ratio, error = _ratio(nominal, chosen, index, seed)
    error = np.where(error < SETTLED, error, np.inf)
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

    Where nothing avoids c the error is infinite.
    """
    problem = nominal.problem
    constraint = problem.hypotheses.constraint(index)
    narrower = dataclasses.replace(problem, known=[*problem.known, constraint])
    log_ratio = np.zeros(evidence.num_tasks)
    error = np.full(evidence.num_tasks, np.inf)
    for _ in range(MAX_ROUNDS):
        assert isinstance(nominal.solver, AdaptingSolver)
        nominal = nominal.solver.adapt(nominal, narrower, seed)
        try:
            avoiding = sample(nominal, evidence.tasks, NUM_TRAJECTORIES, method="smc", seed=seed)
        except ValueError as problem_found:
            if "enter a known constraint" in str(problem_found):
                break
            raise
        log_ratio = avoiding.log_partition - evidence.log_partition
        error = np.hypot(avoiding.island_spread, evidence.island_spread) / NUM_ISLANDS**0.5
        if (error < SETTLED).all():
            break
    return log_ratio, error
