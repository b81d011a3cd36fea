"""Near-certain violations: hypotheses that hardly any nominal trajectory avoids.

Where all samples enter c they only say that Z_c / Z_0 is small; where two or three do not, chance
says how small. What driving round c would cost is then told with c in force: the solver adapts what
it learned to pi_c, the MDP with c among the known constraints, and sequential Monte Carlo with the
adapted soft value gives Z_c,

    log(Z_c / Z_0) = log Z_c - log Z_0,

however small. It is worked out for what matters: hypotheses that no demonstration enters and that
the samples leave open, in the tasks of the demonstrations.

Shapes: K tasks, H hypotheses, I islands.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any, Protocol, runtime_checkable

import numpy as np

from swerve.base.progress import progress_bar
from swerve.base.space import Task
from swerve.evidence.estimators import NothingLeftError
from swerve.evidence.evidence import Evidence
from swerve.inference.ranking import SETTLED, Inference
from swerve.problem.problem import Problem
from swerve.sampling.sample import sample
from swerve.solvers.learn import Nominal, Solver

NUM_TRAJECTORIES = 2_000, 10_000  # a task and hypothesis; the second where the first do not settle
LEAST_SHARE = 0.05  # of them that must be effective: what next to nothing is left of comes out low
UNLIKELY = 1e-3  # probability of as few or as many samples that avoid a hypothesis as there are


@runtime_checkable
class AdaptingSolver(Solver, Protocol):
    """A solver whose soft value can be adapted to more known constraints."""

    def adapted(self, nominal: Any, problem: Problem, seed: int) -> Iterator[Nominal]:
        """Yield the nominal distribution of a problem with more known constraints, ever better."""
        ...


def resolve(
    nominal: Nominal,
    inference: Inference,
    *,
    seed: int = 0,
    progress: bool = False,
    keep: Callable[[Evidence], None] = lambda evidence: None,
) -> Evidence:
    """Work out the ratios that evidence leaves open, for hypotheses that matter to a ranking.

    Args:
      nominal: what the evidence was sampled from.
      inference: from evidence in which next to no trajectory avoids some hypotheses; those that it
        strikes out are left out.
      seed: of everything random.
      progress: whether to show a progress bar.
      keep: called with what there is after each hypothesis, since all of them may take long.

    Returns:
      Its evidence with numbers worked out in place of bounds, and of what two or three trajectories
      say. These remain where even with c in force no trajectory avoids it, or it is not well enough
      known how many do: `log_ratio_error` of the summary is then infinite.

    Raises:
      ValueError: if the nominal has no soft value, or is of another problem.
    """
    if not isinstance(nominal.solver, AdaptingSolver):
        raise ValueError(
            "nominal: expected one of a solver with a soft value that adapts (grid, soft-value), "
            f"got {nominal.solver.name!r}"
        )
    evidence = inference.evidence
    if nominal.problem.record.fingerprint != evidence.problem.fingerprint:
        raise ValueError(
            f"the evidence is of another problem, {evidence.problem.summary}, than the nominal, "
            f"{nominal.problem.record.summary}"
        )
    is_open = inference.is_open
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

    The error is infinite where that did not settle it, or contradicts the samples without c, which
    know next to nothing of who avoids it, but not nothing.
    """
    problem, solver = nominal.problem, nominal.solver
    assert isinstance(solver, AdaptingSolver)
    constraint = problem.hypotheses.constraint(index)
    narrower = dataclasses.replace(problem, known=[*problem.known, constraint])
    log_ratio, error = np.zeros(evidence.num_tasks), np.full(evidence.num_tasks, np.inf)
    for adapted in solver.adapted(nominal, narrower, seed):
        for k in np.flatnonzero(np.isinf(error)).tolist():
            avoiding = _settled(adapted, evidence.select([k]).tasks, seed)
            if avoiding is None:
                continue
            found = avoiding.log_partition[0] - evidence.log_partition[k]
            if _is_likely(evidence, k, index, found):
                of_both = avoiding.log_partition_error[0], evidence.log_partition_error[k]
                log_ratio[k], error[k] = found, math.hypot(*of_both)
        if np.isfinite(error).all():
            break
    return log_ratio, error


def _settled(nominal: Nominal, task: Task, seed: int) -> Evidence | None:
    """Return evidence of one task whose log Z is well known, None where its samples do not tell."""
    for num in NUM_TRAJECTORIES:
        try:
            evidence = sample(nominal, task, num, method="smc", seed=seed)
        except NothingLeftError:
            return None
        if evidence.effective_sample_size[0] < LEAST_SHARE * evidence.num_trajectories:
            return None
        if evidence.log_partition_error[0] < SETTLED / math.sqrt(2.0):
            return evidence
    return None


def _is_likely(evidence: Evidence, task: int, index: int, log_ratio: float) -> bool:
    """Return whether a ratio agrees with how few trajectories avoid the hypothesis, by Poisson."""
    seen = 0
    if not evidence.is_floored[task, index]:
        seen = round(evidence.standard_error[task, index] ** -2)
    expected = math.exp(log_ratio) / evidence.resolution[task]
    terms = [math.exp(-expected) * expected**k / math.factorial(k) for k in range(seen + 1)]
    return sum(terms) > UNLIKELY and 1.0 - sum(terms[:-1]) > UNLIKELY
