"""Judge how far the samples of each task can be trusted: warnings, and a verdict for each task.

Samples are "not to be trusted" where the effective sample size is below max(100, 2 % of N) (see
`estimators.least_effective`), where independent parts of the samples differ in log Z_0 by more than
HIGH_SPREAD, or where the samples miss more than HIGH_MISSED of pi_0 (see `sampling.missed`).
"Errors may be larger than stated" where the samples miss less, where the policy is far from pi_0,
or where the solver's own log Z_0 differs from that of its samples. Otherwise the order of the first
hypotheses may rest on sampling error. If the error allowed for a difference of scores is shared
evenly among the K tasks in use, task k needs

    N_k = N K (n_k e_k / gap)^2

trajectories, where n_k e_k is twice the sum of the amounts that the task's n_k demonstrations add
to the standard errors of the two scores. No check detects modes that not even explorers find.

Shapes: K tasks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from swerve.base.phrases import NUM_NAMES
from swerve.base.solver_kinds import kind_stored, solver_names
from swerve.evidence.estimators import HOTTEST, LOW_ESS
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import RESAMPLED, TEMPERED
from swerve.inference.ranking import TIE_ERRORS, Ranking

HIGH_KL = {  # nats, by method: above this KL between policy and pi_0, errors may be understated
    "smc": math.inf,
    "tempered": math.inf,
    "importance": 0.5,
    "plain": 0.1,
}
HIGH_SPREAD = 1.0  # nats, standard deviation of log Z_0 over islands: above, the islands disagree
HIGH_MISSED = 0.1  # share of pi_0 that the samples miss: above, no estimate is to be trusted
NUM_ERRORS = 3.0  # standard errors by which the solver's log Z_0 and the samples' may differ
GOOD_ESS_SHARE = 0.3  # share of N: above this ESS, the policy is good but samples are too few
NUM_SETTLED = 3  # hypotheses at the head of the ranking whose order has to be settled
MOST_SAMPLES = 10_000_000  # trajectories per task: larger numbers are never suggested
CLOSED_IN = "by the solver's soft value, known constraints close the start in"
FAR_BEHIND = 7.0  # nats below the first, less errors: 1,000 times less likely, so no order needed


def warnings(inference: Ranking) -> Iterator[str]:
    """Yield warnings about the samples, each kind once."""
    yield from _too_few(inference)
    yield from _apart(inference)
    yield from _missing(inference)
    yield from _too_hot(inference)
    yield from _far_policy(inference)
    yield from _closed_in(inference)
    yield from _wrong_value(inference)


def verdict(inference: Ranking, task: int) -> str:
    """Return how far the samples of a task can be trusted, for example 'settled'."""
    evidence = inference.evidence
    if evidence.is_exact:
        return "exact"
    if _has_too_few(inference)[task]:
        left = f"{evidence.effective_sample_size[task]:.0f} of {evidence.num_trajectories}"
        other = f" at another beta: {_at_its_beta(evidence)}" if evidence.is_of_other_beta else ""
        return f"not to be trusted: effective sample size {left}{other}"
    if _is_apart(inference)[task]:
        return f"not to be trusted: parts of its samples differ {_apart_by(evidence, task)}"
    if _misses(inference)[task]:
        return f"{_missing_text(evidence.missed_share[task])} of pi_0 was not sampled"
    if is_too_hot(evidence):
        return f"errors may be larger than stated: {_at_its_beta(evidence)}"
    if _is_far(inference)[task]:
        return f"errors may be larger than stated: KL {evidence.kl[task]:.2f} nats"
    if _is_closed(inference)[task]:
        return f"errors may be larger than stated: {CLOSED_IN}"
    if (_value_gap(inference) > 0.0)[task]:
        values = f"{evidence.soft_value[task]:.2f}, not {evidence.log_partition[task]:.2f} nats"
        return f"errors may be larger than stated: the solver's log Z_0 is {values}"
    num, needed = evidence.num_trajectories, _samples_needed(inference, task)
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
    texts = {task: verdict(inference, task) for task in tasks}
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


def _samples_needed(inference: Ranking, task: int) -> np.ndarray:
    """Return N_k of the module's formula for each gap between neighbours of the first hypotheses.

    N_k is infinite where a score rests on a number that more samples do not change. N_k is 0 for
    hypotheses that explain nothing within the errors, or are far behind the first hypothesis: these
    need no order.
    """
    first = inference.ranking[: NUM_SETTLED + 1]
    evidence, sample_of = inference.evidence, inference.evidence.sample_of
    num_tasks = len(set(sample_of[inference.task_counts > 0].tolist()))  # equal tasks count once
    error = inference.task_error[sample_of == sample_of[task]][:, first].sum(axis=0)
    score = inference.score[first]
    gap = np.maximum(score[:-1] - score[1:], 1e-12)
    share = num_tasks * (TIE_ERRORS * (error[1:] + error[:-1]) / gap) ** 2
    needs_none = score[:-1] <= TIE_ERRORS * inference.score_error[first[:-1]]
    if inference.score_name == "likelihood":
        doubt = TIE_ERRORS * (inference.score_error[first[:1]] + inference.score_error[first[:-1]])
        needs_none |= score[:1] - score[:-1] - doubt > FAR_BEHIND
    share[needs_none] = 0.0
    is_fixed = (evidence.is_resolved | evidence.is_floored)[task, first]
    share[(share > 1.0) & (is_fixed[1:] | is_fixed[:-1])] = np.inf
    return evidence.num_trajectories * share


def _round_up(number: float) -> int:
    """Return a number rounded up to two digits."""
    unit = 10 ** max(0, math.floor(math.log10(number)) - 1)
    return unit * math.ceil(number / unit)


def is_untrusted(inference: Ranking) -> bool:
    """Return whether the samples of a task in use are not to be trusted at all."""
    if inference.evidence.is_exact:
        return False
    is_far_off = _misses(inference) & (inference.evidence.missed_share > HIGH_MISSED)
    return bool((_has_too_few(inference) | _is_apart(inference) | is_far_off).any())


def is_too_hot(evidence: Evidence) -> bool:
    """Return whether beta is too far below `sampling_beta` for the weights to be trusted.

    Trajectories that are common at a low beta may be too rare at a high beta to be sampled at all.
    The effective sample size does not show that such trajectories are missing.
    """
    return evidence.problem.beta < HOTTEST * evidence.sampling_beta


def _has_too_few(inference: Ranking) -> np.ndarray:
    """Return [K] True where the effective sample size of a task in use is too small."""
    return inference.evidence.has_too_few & (inference.task_counts > 0)


def _is_apart(inference: Ranking) -> np.ndarray:
    """Return [K] True where independent parts of the samples disagree on log Z_0."""
    used = (inference.task_counts > 0) & ~_has_too_few(inference)
    return used & (inference.evidence.island_spread > HIGH_SPREAD)


def _misses(inference: Ranking) -> np.ndarray:
    """Return [K] True where exploring found a part of pi_0 that the samples miss."""
    used = (inference.task_counts > 0) & ~_has_too_few(inference)
    return used & inference.evidence.is_missing


def _missing_text(share: float) -> str:
    doubt = "not to be trusted" if share > HIGH_MISSED else "errors may be larger than stated"
    return f"{doubt}: about {100 * share:.2g} %"


def _is_far(inference: Ranking) -> np.ndarray:
    """Return [K] True where the policy of a task is too far from pi_0."""
    used = (inference.task_counts > 0) & ~_has_too_few(inference)
    return used & (inference.evidence.kl > HIGH_KL[inference.evidence.method])


def _is_closed(inference: Ranking) -> np.ndarray:
    """Return [K] True where by the solver's soft value nobody gets out of the start."""
    used = (inference.task_counts > 0) & ~_has_too_few(inference)
    return used & np.isneginf(inference.evidence.soft_value)


def _value_gap(inference: Ranking) -> np.ndarray:
    """Return [K] the unexplained gap between log Z_0 of the solver and of its samples, nats.

    Importance weights explain a gap of -log(ESS / N), for example where only the share ESS / N of
    the trajectories survives a wall. Resampled trajectories of a grid do not explain this gap,
    since their ESS counts ancestors. The gap is 0 for tasks not in use, and where the solver has no
    soft value or closes the start in.
    """
    evidence = inference.evidence
    kind = kind_stored(evidence.solver)
    used = (inference.task_counts > 0) & ~_has_too_few(inference)
    share = evidence.effective_sample_size / evidence.num_trajectories
    error = np.sqrt(np.maximum(1.0 / share - 1.0, 0.0) / evidence.num_trajectories)  # in log Z_0
    if evidence.method in RESAMPLED and kind.computes_value:
        share, error = np.ones_like(share), evidence.log_partition_error
    explained = NUM_ERRORS * error - np.log(share)
    allowed = kind.value_gap or 0.0
    has_value = np.isfinite(evidence.soft_value)
    value = np.where(has_value, evidence.soft_value, evidence.log_partition)
    gap = np.abs(value - evidence.log_partition) - explained - allowed
    return np.where(used & has_value & (gap > 0.0), gap, 0.0)


def _too_few(inference: Ranking) -> Iterator[str]:
    evidence, used, low = inference.evidence, inference.task_counts > 0, _has_too_few(inference)
    ess, num = evidence.effective_sample_size, evidence.num_trajectories
    if low.any():
        worst = int(np.flatnonzero(low)[ess[low].argmin()])
        yield (
            f"not to be trusted: the effective sample size is too low for {low.sum()} of "
            f"{np.count_nonzero(used)} tasks (worst: {inference.task_name(worst)}, "
            f"{ess[worst]:.0f} of {num}). {_remedy(evidence, ess[worst] / num)}"
        )


def _apart(inference: Ranking) -> Iterator[str]:
    evidence, apart = inference.evidence, _is_apart(inference)
    if apart.any():
        worst = int(np.where(apart, evidence.island_spread, 0.0).argmax())
        yield (
            f"not to be trusted: for {apart.sum()} of {np.count_nonzero(inference.task_counts)} "
            "tasks independent parts of the samples disagree on log Z_0 (worst: "
            f"{inference.task_name(worst)}, {_apart_by(evidence, worst)}). "
            f"{_remedy(evidence)}"
        )


def _apart_by(evidence: Evidence, task: int) -> str:
    """Return by how much parts of the samples of a task disagree on log Z_0."""
    spread = evidence.island_spread[task]
    if math.isinf(spread):
        return "in log Z_0: in one of them every trajectory enters a known constraint"
    return f"by {spread:.1f} nats in log Z_0"


def _missing(inference: Ranking) -> Iterator[str]:
    """Yield a warning where trajectories that explore found what no sampled trajectory does."""
    evidence, missing = inference.evidence, _misses(inference)
    if missing.any():
        worst = int(np.where(missing, evidence.missed_share, 0.0).argmax())
        yield (
            f"{_missing_text(evidence.missed_share[worst])} of pi_0 was not sampled for "
            f"{inference.task_name(worst)}, the worst of {missing.sum()} such tasks of "
            f"{np.count_nonzero(inference.task_counts)}, but found by trajectories that deviate "
            f"from the policy. {_remedy(evidence)}"
        )


def _too_hot(inference: Ranking) -> Iterator[str]:
    if is_too_hot(inference.evidence):
        yield (
            "errors may be larger than stated: beta is below half of the beta sampled for, and "
            "trajectories that are common at this beta may be missing from the samples. "
            f"{_remedy(inference.evidence)}"
        )


def _far_policy(inference: Ranking) -> Iterator[str]:
    """Yield a warning where the policy is so far from pi_0 that errors may be understated."""
    evidence, far = inference.evidence, _is_far(inference)
    if far.any():
        worst = int(np.where(far, evidence.kl, 0.0).argmax())
        cause = "trajectories that the policy hardly ever takes may be missing"
        if evidence.method == "plain":
            cause = "plain weights assume that the policy is pi_0: use importance weights"
        yield (
            f"errors may be larger than stated: for {far.sum()} of "
            f"{np.count_nonzero(inference.task_counts)} tasks the policy is more than "
            f"{HIGH_KL[evidence.method]:g} nats from pi_0 (worst: {inference.task_name(worst)}, KL "
            f"{evidence.kl[worst]:.2f}), and {cause}. {_remedy(evidence)}"
        )


def _closed_in(inference: Ranking) -> Iterator[str]:
    """Yield a warning where nobody gets out of a start by the solver, and samples do."""
    closed = _is_closed(inference)
    if closed.any():
        first = int(closed.argmax())
        yield (
            f"errors may be larger than stated: {CLOSED_IN} for {np.count_nonzero(closed)} of "
            f"{np.count_nonzero(inference.task_counts)} tasks (first: "
            f"{inference.task_name(first)}), yet samples get out. {_remedy(inference.evidence)}"
        )


def _wrong_value(inference: Ranking) -> Iterator[str]:
    """Yield a warning where log Z_0 of the solver differs from log Z_0 of the samples."""
    evidence, gap = inference.evidence, _value_gap(inference)
    if gap.any():
        worst = int(gap.argmax())
        yield (
            f"errors may be larger than stated: for {np.count_nonzero(gap)} of "
            f"{np.count_nonzero(inference.task_counts)} tasks the solver's log Z_0 is not that of "
            f"its samples (worst: {inference.task_name(worst)}, "
            f"{evidence.soft_value[worst]:.2f} and {evidence.log_partition[worst]:.2f} nats). "
            f"{_remedy(evidence)}"
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
