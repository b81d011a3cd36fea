"""Judge how far the samples of each task can be trusted: warnings, and a verdict for each task.

Samples that fail a check (see `sample_checks`) are "not to be trusted", or their "errors may be
larger than stated". Otherwise the order of the first hypotheses may rest on sampling error. If the
error allowed for a difference of scores is shared evenly among the K tasks in use, task k needs

    N_k = N K (n_k e_k / gap)^2

trajectories, where n_k e_k is twice the sum of the amounts that the task's n_k demonstrations add
to the standard errors of the two scores. No check detects modes that not even explorers find.

Shapes: K tasks, M of them asked for, G gaps between neighbours of the ranking.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from swerve.base.groups import sums_of_groups
from swerve.base.phrases import NUM_NAMES
from swerve.base.solver_kinds import kind_stored, solver_names
from swerve.evidence.estimators import HOTTEST, LOW_ESS
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import TEMPERED
from swerve.hypotheses.same import same_as
from swerve.inference.ranking import TIE_ERRORS, Ranking
from swerve.trust.sample_checks import HIGH_KL, HIGH_MISSED, Checks, sample_checks

GOOD_ESS_SHARE = 0.3  # share of N: above this ESS, the policy is good but samples are too few
NUM_SETTLED = 3  # hypotheses at the head of the ranking whose order has to be settled
MOST_SAMPLES = 10_000_000  # trajectories per task: larger numbers are never suggested
CLOSED_IN = "by the solver's soft value, known constraints close the start in"
FAR_BEHIND = 7.0  # nats below the first, less errors: 1,000 times less likely, so no order needed


def warnings(inference: Ranking) -> Iterator[str]:
    """Yield warnings about the samples, each kind once."""
    checks = sample_checks(inference)
    yield from _too_few(inference, checks)
    yield from _apart(inference, checks)
    yield from _missing(inference, checks)
    yield from _too_hot(inference)
    yield from _far_policy(inference, checks)
    yield from _closed_in(inference, checks)
    yield from _wrong_value(inference, checks)


def verdict(inference: Ranking, task: int) -> str:
    """Return how far the samples of a task can be trusted, for example 'settled'."""
    return verdicts(inference, [task])[0]


def verdicts(inference: Ranking, tasks: Sequence[int]) -> list[str]:
    """Return how far the samples of each of some tasks can be trusted, for example 'settled'."""
    if inference.evidence.is_exact:
        return ["exact"] * len(tasks)
    checks, needed = sample_checks(inference), _samples_needed(inference, tasks)
    return [
        _doubt(inference.evidence, checks, task) or _settled(inference.evidence, num)
        for task, num in zip(tasks, needed, strict=True)
    ]


def _doubt(evidence: Evidence, checks: Checks, task: int) -> str:
    """Return the first reason not to trust the samples of a task; '' if there is none."""
    if checks.too_few[task]:
        left = f"{evidence.effective_sample_size[task]:.0f} of {evidence.num_trajectories}"
        other = f" at another beta: {_at_its_beta(evidence)}" if evidence.is_of_other_beta else ""
        return f"not to be trusted: effective sample size {left}{other}"
    if checks.apart[task]:
        return f"not to be trusted: parts of its samples differ {_apart_by(evidence, task)}"
    if checks.missing[task]:
        return _missing_text(evidence, task)
    if is_too_hot(evidence):
        return f"errors may be larger than stated: {_at_its_beta(evidence)}"
    if checks.far[task]:
        return f"errors may be larger than stated: KL {evidence.kl[task]:.2f} nats"
    if checks.closed[task]:
        return f"errors may be larger than stated: {CLOSED_IN}"
    if checks.value_gap[task]:
        values = f"{evidence.soft_value[task]:.2f}, not {evidence.log_partition[task]:.2f} nats"
        return f"errors may be larger than stated: the solver's log Z_0 is {values}"
    return ""


def _settled(evidence: Evidence, needed: np.ndarray) -> str:
    """Return whether the samples of a task settle the ranking, given the numbers that it needs."""
    num = evidence.num_trajectories
    if needed.max(initial=0.0) <= num:
        return "settled"
    text = f"ranking of the first {NUM_SETTLED} not settled"
    if needed[0] <= num:
        text += " (the first is)"
    if needed.max() > MOST_SAMPLES:
        return f"{text}, and more samples will not settle it"
    return f"{text}: raise --samples to about {_round_up(needed.max()):,}"


def summary(inference: Ranking) -> str:
    """Return the verdicts of all tasks in use, in a few lines."""
    tasks = np.flatnonzero(inference.task_counts).tolist()
    texts = dict(zip(tasks, verdicts(inference, tasks), strict=True))
    others = [task for task in tasks if texts[task] not in ("settled", "exact")]
    if not others:
        return f"{len(tasks)} of {len(tasks)} tasks {texts[tasks[0]]}"
    lines = [f"{len(tasks) - len(others)} of {len(tasks)} tasks settled"]
    lines += [f"  {inference.task_name(k)}: {texts[k]}" for k in others[:NUM_NAMES]]
    if len(others) > NUM_NAMES:
        lines.append(
            f"  ... and {len(others) - NUM_NAMES} more not settled: see --json or --report"
        )
    return "\n".join(lines)


def _samples_needed(inference: Ranking, tasks: Sequence[int]) -> np.ndarray:
    """Return N_k [M, G] of the module's formula for each gap between the first hypotheses.

    N_k is infinite where a score rests on a number that more samples do not change. N_k is 0 for
    hypotheses that explain nothing within the errors, are far behind the first hypothesis, or are
    the same set as the next: these need no order.

    Args:
      inference: a ranking by sampled evidence.
      tasks: [M] numbers of tasks.
    """
    first = inference.ranking[: NUM_SETTLED + 1]
    evidence, sample_of = inference.evidence, inference.evidence.sample_of
    num_tasks = len(set(sample_of[inference.task_counts > 0].tolist()))  # equal tasks count once
    of_sample = sums_of_groups(inference.task_error[:, first], sample_of, sample_of.max() + 1)
    error = of_sample[sample_of][tasks].T
    score = inference.score[first]
    gap = np.maximum(score[:-1] - score[1:], 1e-12)[:, None]
    share = num_tasks * (TIE_ERRORS * (error[1:] + error[:-1]) / gap) ** 2
    needs_none = score[:-1] <= TIE_ERRORS * inference.score_error[first[:-1]]
    if inference.score_name == "likelihood":
        doubt = TIE_ERRORS * (inference.score_error[first[:1]] + inference.score_error[first[:-1]])
        needs_none |= score[:1] - score[:-1] - doubt > FAR_BEHIND
    alike = same_as(evidence.problem.hypotheses, evidence.problem.space)[first]
    needs_none |= alike[:-1] == alike[1:]
    share[needs_none] = 0.0
    is_fixed = (evidence.is_resolved | evidence.is_floored)[:, first][tasks].T
    share[(share > 1.0) & (is_fixed[1:] | is_fixed[:-1])] = np.inf
    return evidence.num_trajectories * share.T


def _round_up(number: float) -> int:
    """Return a number rounded up to two digits."""
    unit = 10 ** max(0, math.floor(math.log10(number)) - 1)
    return unit * math.ceil(number / unit)


def is_untrusted(inference: Ranking) -> bool:
    """Return whether the samples of a task in use are not to be trusted at all."""
    if inference.evidence.is_exact:
        return False
    checks = sample_checks(inference)
    is_far_off = checks.missing & (inference.evidence.missed_share > HIGH_MISSED)
    return bool((checks.too_few | checks.apart | is_far_off).any())


def is_too_hot(evidence: Evidence) -> bool:
    """Return whether beta is too far below `sampling_beta` for the weights to be trusted.

    Trajectories that are common at a low beta may be too rare at a high beta to be sampled at all.
    The effective sample size does not show that such trajectories are missing.
    """
    return evidence.problem.beta < HOTTEST * evidence.sampling_beta


def _missing_text(evidence: Evidence, task: int) -> str:
    """Return how much of pi_0 was not sampled, with the beta of pi_0 where it is not this beta."""
    share, at = evidence.missed_share[task], ""
    if evidence.is_of_other_beta:  # nobody explored pi_0 at this beta
        at = f" at beta {evidence.sampling_beta:g}, the beta of sampling,"
    doubt = "not to be trusted" if share > HIGH_MISSED else "errors may be larger than stated"
    return f"{doubt}: about {100 * share:.2g} % of pi_0{at} was not sampled"


def _worst(
    inference: Ranking, fails: np.ndarray, size: np.ndarray
) -> Iterator[tuple[int, str, str]]:
    """Yield the task of the largest size [K] that fails a check [K], if any task fails it.

    The task comes with its name and the share of the tasks in use that fail: '3 of 7 tasks'.
    """
    if fails.any():
        worst = int(np.where(fails, size, -np.inf).argmax())
        num, num_used = (np.count_nonzero(tasks) for tasks in (fails, inference.task_counts))
        yield worst, inference.task_name(worst), f"{num} of {num_used} tasks"


def _too_few(inference: Ranking, checks: Checks) -> Iterator[str]:
    evidence, ess = inference.evidence, inference.evidence.effective_sample_size
    for worst, name, share in _worst(inference, checks.too_few, -ess):
        num = evidence.num_trajectories
        yield (
            f"not to be trusted: the effective sample size is too low for {share} (worst: {name}, "
            f"{ess[worst]:.0f} of {num}). {_remedy(evidence, ess[worst] / num)}"
        )


def _apart(inference: Ranking, checks: Checks) -> Iterator[str]:
    evidence = inference.evidence
    for worst, name, share in _worst(inference, checks.apart, evidence.island_spread):
        yield (
            f"not to be trusted: for {share} independent parts of the samples disagree on log Z_0 "
            f"(worst: {name}, {_apart_by(evidence, worst)}). {_remedy(evidence)}"
        )


def _apart_by(evidence: Evidence, task: int) -> str:
    """Return by how much parts of the samples of a task disagree on log Z_0."""
    spread = evidence.island_spread[task]
    if math.isinf(spread):
        return "in log Z_0: in one of them every trajectory enters a known constraint"
    return f"by {spread:.1f} nats in log Z_0"


def _missing(inference: Ranking, checks: Checks) -> Iterator[str]:
    """Yield a warning where trajectories that explore found what no sampled trajectory does."""
    evidence = inference.evidence
    num, num_used = (np.count_nonzero(tasks) for tasks in (checks.missing, inference.task_counts))
    for worst, name, _ in _worst(inference, checks.missing, evidence.missed_share):
        yield (
            f"{_missing_text(evidence, worst)} for {name}, the worst of {num} such tasks of "
            f"{num_used}, but found by trajectories that deviate from the policy. "
            f"{_remedy(evidence)}"
        )


def _too_hot(inference: Ranking) -> Iterator[str]:
    if is_too_hot(inference.evidence):
        yield (
            "errors may be larger than stated: beta is below half of the beta sampled for, and "
            "trajectories that are common at this beta may be missing from the samples. "
            f"{_remedy(inference.evidence)}"
        )


def _far_policy(inference: Ranking, checks: Checks) -> Iterator[str]:
    """Yield a warning where the policy is so far from pi_0 that errors may be understated."""
    evidence = inference.evidence
    cause = "trajectories that the policy hardly ever takes may be missing"
    if evidence.method == "plain":
        cause = "plain weights assume that the policy is pi_0: use importance weights"
    for worst, name, share in _worst(inference, checks.far, evidence.kl):
        yield (
            f"errors may be larger than stated: for {share} the policy is more than "
            f"{HIGH_KL[evidence.method]:g} nats from pi_0 (worst: {name}, KL "
            f"{evidence.kl[worst]:.2f}), and {cause}. {_remedy(evidence)}"
        )


def _closed_in(inference: Ranking, checks: Checks) -> Iterator[str]:
    """Yield a warning where nobody gets out of a start by the solver, and samples do."""
    for _, name, share in _worst(inference, checks.closed, np.zeros(len(checks.closed))):
        yield (
            f"errors may be larger than stated: {CLOSED_IN} for {share} (first: {name}), yet "
            f"samples get out. {_remedy(inference.evidence)}"
        )


def _wrong_value(inference: Ranking, checks: Checks) -> Iterator[str]:
    """Yield a warning where log Z_0 of the solver differs from log Z_0 of the samples."""
    evidence, gap = inference.evidence, checks.value_gap
    for worst, name, share in _worst(inference, gap > 0.0, gap):
        values = f"{evidence.soft_value[worst]:.2f} and {evidence.log_partition[worst]:.2f} nats"
        yield (
            f"errors may be larger than stated: for {share} the solver's log Z_0 is not that of "
            f"its samples (worst: {name}, {values}). {_remedy(evidence)}"
        )


def _at_its_beta(evidence: Evidence) -> str:
    beta = f"{evidence.problem.beta:g}"
    return f"sample at beta {beta} itself: swerve.sample(nominal, tasks, beta={beta})"


def _remedy(evidence: Evidence, share: float = 0.0) -> str:
    """Return advice on what to do about samples that cannot be trusted.

    Args:
      evidence: evidence with the samples.
      share: effective sample size over N.
    """
    if evidence.is_of_other_beta:
        return (
            f"The trajectories were sampled for beta {evidence.sampling_beta:g}, and weighed for "
            f"{evidence.problem.beta:g}: {_at_its_beta(evidence)}"
        )
    if evidence.method == TEMPERED:
        return (
            "Tempering has left too few trajectories: sample more, or learn at a beta nearer to "
            f"{evidence.problem.beta:g}"
        )
    if share > GOOD_ESS_SHARE:
        return f"Sample more trajectories: at least {LOW_ESS / share:.0f}"
    kind = kind_stored(evidence.solver)
    if not kind.finer:
        others = " and ".join(solver_names(lambda kind: kind.adapts))
        return (
            "The policy is far from pi_0 here: sample more trajectories, or use a solver that "
            f"comes nearer to pi_0 ({others})"
        )
    if kind.computes_value:
        text = f"The grid is too coarse for this problem: give it more {kind.finer}"
        other = ", or take method 'importance', which needs no soft value on the way"
        return text + other * (evidence.method == "smc" and not evidence.is_missing.any())
    return (
        "The policy is far from pi_0 here: train it longer (num_steps), or use the grid solver "
        "where the state has at most 3 dimensions. The policy was not trained for tasks unlike "
        "those of sample_task. Where rewards are too sharp to be learned, learn for a lower beta "
        "and reach this beta in steps, in Python: swerve.sample(nominal, tasks, "
        f"beta={evidence.problem.beta:g})"
    )
