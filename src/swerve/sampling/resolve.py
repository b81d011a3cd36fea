"""Resolve near-certain violations: hypotheses that hardly any nominal trajectory avoids.

Where all samples enter c, they tell only that Z_c / Z_0 is small. Where two or three samples avoid
c, the ratio is left to chance. Then Z_c is estimated with c in force: the solver adapts its soft
value to pi_c, the policy of the MDP with c among the known constraints, and sequential Monte Carlo
with the adapted soft value gives Z_c, however small:

    log(Z_c / Z_0) = log Z_c - log Z_0.

Only hypotheses that can change the answer are resolved (`worth_resolving`), in the tasks of the
demonstrations: the best first, as far as the time goes. Hypotheses that are the same set share one
estimate.

Shapes: K tasks, H hypotheses, I islands.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from time import monotonic

import numpy as np

from swerve.base.arguments import number_or_nan, seed_number
from swerve.base.forked import check_process
from swerve.base.progress import progress_bar
from swerve.base.solver_kinds import solver_names
from swerve.base.space import Task
from swerve.evidence.estimators import NothingLeftError
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import RESOLVED
from swerve.hypotheses.same import same_as
from swerve.inference.ranking import Ranking
from swerve.inference.scores import SETTLED
from swerve.inference.unresolved import worth_resolving
from swerve.sampling.sample import sample
from swerve.solvers.base import AdaptingSolver, Nominal

# trajectories for a task and a hypothesis: the second number if the first leaves too large an error
NUM_TRAJECTORIES = 2_000, 10_000
LEAST_SHARE = 0.05  # share of these that must be effective: with fewer, Z_c is estimated too low
MOST_MISSED = 0.05  # share of pi_c that these may miss: with more, Z_c is estimated too low
UNLIKELY = 1e-3  # a ratio is refuted if as few, or as many, samples avoid c with less probability


def resolve(
    nominal: Nominal,
    inference: Ranking,
    *,
    seed: int = 0,
    seconds: float = math.inf,
    progress: bool = False,
    keep: Callable[[Evidence], None] = lambda evidence: None,
) -> Evidence:
    """Estimate the ratios that evidence leaves open, for hypotheses that can change a ranking.

    Hypotheses that rank first by the samples come first, so that time runs out on the last ones.

    Args:
      nominal: the nominal distribution that the evidence was sampled from.
      inference: ranking from evidence in which almost no trajectory avoids some hypotheses;
        hypotheses that are struck out stay as they are.
      seed: seed of everything random.
      seconds: time after which no further estimate begins [s]; the first one always begins. What is
        then left stays open: another call goes on from the evidence that this call returned.
      progress: whether to show a progress bar.
      keep: called with the evidence so far after each hypothesis, since all may take long.

    Returns:
      The evidence of the inference, with estimates in place of bounds, and in place of ratios known
      from two or three trajectories alone. The old value remains where even with c in force no
      trajectory avoids c, or the error of Z_c stays too large: `log_ratio_error` of the summary is
      then infinite.

    Raises:
      ValueError: if the nominal has no soft value, or is of another problem; if `seconds` is not a
        number above 0.
    """
    check_process()
    evidence = inference.evidence
    _check(nominal, evidence, seconds)
    seed, deadline = seed_number(seed), monotonic() + seconds
    left = worth_resolving(inference)
    first = same_as(evidence.problem.hypotheses, evidence.problem.space)
    with progress_bar("resolving", len(left), progress) as advance:
        while len(left):
            alike = first == first[left[0]]  # the same set: one estimate, and one error, for all
            is_open = inference.is_open[:, left[0]]
            alike &= (is_open == inference.is_open.T).all(axis=1)
            advance(0, note=f"hypothesis {left[0]}")
            evidence = _resolved(nominal, evidence, alike, is_open, seed, deadline)
            keep(evidence)
            advance(int(alike[left].sum()))
            left = left[~alike[left] & (monotonic() < deadline)]
    return evidence


def _check(nominal: Nominal, evidence: Evidence, seconds: float) -> None:
    """Raise ValueError if a nominal does not adapt or fit the evidence, or the time is not > 0."""
    if not number_or_nan(seconds) > 0.0:
        raise ValueError(f"seconds: expected a number of seconds > 0, got {seconds!r}")
    if not isinstance(nominal.solver, AdaptingSolver):
        adapting = ", ".join(solver_names(lambda kind: kind.adapts))
        raise ValueError(
            f"nominal: expected one by a solver with a soft value that adapts ({adapting}), got "
            f"{nominal.solver.name!r}"
        )
    if nominal.problem.record.fingerprint != evidence.problem.fingerprint:
        raise ValueError(
            f"the evidence is of another problem than the nominal: {evidence.problem.summary}, "
            f"not {nominal.problem.record.summary}"
        )


def _resolved(
    nominal: Nominal,
    evidence: Evidence,
    alike: np.ndarray,
    is_open: np.ndarray,
    seed: int,
    deadline: float,
) -> Evidence:
    """Return evidence with the ratio of a hypothesis, in the tasks in which the ratio settles.

    Args:
      nominal: the nominal distribution.
      evidence: evidence with the ratio open.
      alike: [H] True for the hypothesis, and for others that are the same set.
      is_open: [K] True for the tasks in which the ratio is open.
      seed: seed of everything random.
      deadline: time of the monotonic clock [s] after which no estimate begins.
    """
    hypotheses, tasks = np.flatnonzero(alike), np.flatnonzero(is_open)
    chosen = evidence.select(tasks.tolist())
    log_ratio, error = _ratio(nominal, chosen, int(hypotheses[0]), seed, deadline)
    settled = np.isfinite(error)
    ratio = np.exp(log_ratio)
    columns = ratio, (ratio * error) ** 2, log_ratio, error
    changed = {name: getattr(evidence.summary, name).copy() for name in RESOLVED}
    for name, values in zip(RESOLVED, columns, strict=True):
        changed[name][np.ix_(tasks[settled], hypotheses)] = values[settled, None]
    changed["log_ratio_error"][np.ix_(tasks, hypotheses)] = error[:, None]
    return dataclasses.replace(evidence, summary=evidence.summary._replace(**changed))


def _ratio(
    nominal: Nominal, evidence: Evidence, index: int, seed: int, deadline: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return log Z_c / Z_0 and its standard error [K] for all tasks of evidence, nats.

    The error is infinite where the error of Z_c stays too large, or the ratio contradicts how many
    samples avoid c without c in force. It is NaN where time ran out before this could be told.
    """
    problem, solver = nominal.problem, nominal.solver
    assert isinstance(solver, AdaptingSolver)
    constraint = problem.hypotheses.constraint(index)
    narrower = dataclasses.replace(problem, known=[*problem.known, constraint])
    log_ratio, error = np.zeros(evidence.num_tasks), np.full(evidence.num_tasks, np.inf)
    # errors of sets that differ count as independent, so none has the random numbers of another
    own_seed = int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
    has_begun = False  # the first estimate is made however late it is
    for adapted in solver.adapted(nominal, narrower, seed):
        for k in np.flatnonzero(np.isinf(error)).tolist():
            if has_begun and monotonic() >= deadline:
                return log_ratio, np.where(np.isinf(error), np.nan, error)
            has_begun = True
            avoiding = _settled(adapted, evidence.select([k]).tasks, own_seed)
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
    """Return evidence of one task whose log Z has a small error; None if sampling gives none."""
    for num in NUM_TRAJECTORIES:
        try:
            evidence = sample(nominal, task, num, method="smc", seed=seed)
        except NothingLeftError:
            return None
        if evidence.effective_sample_size[0] < LEAST_SHARE * evidence.num_trajectories:
            return None
        if evidence.missed_share[0] > MOST_MISSED:
            return None
        if evidence.log_partition_error[0] < SETTLED / math.sqrt(2.0):
            return evidence
    return None


def _is_likely(evidence: Evidence, task: int, index: int, log_ratio: float) -> bool:
    """Return whether a ratio agrees with the number of samples that avoid c, a Poisson variable."""
    seen = 0
    if not evidence.is_floored[task, index]:
        seen = round(evidence.standard_error[task, index] ** -2)
    expected = math.exp(log_ratio) / evidence.resolution[task]
    terms = [math.exp(-expected) * expected**k / math.factorial(k) for k in range(seen + 1)]
    return sum(terms) > UNLIKELY and 1.0 - sum(terms[:-1]) > UNLIKELY
