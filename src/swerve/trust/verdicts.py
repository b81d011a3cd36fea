"""How far the samples of each task can be trusted: warnings, and one plain verdict a task.

Next to nothing may be left of the trajectories by weight; independent parts of them may disagree on
log Z_0; the policy may be known to be far from pi_0, or the solver's own log Z_0 to differ. Else
the ranking of the first few hypotheses may hang on sampling error: with the error that a difference
of scores may have shared evenly among the K tasks in use, task k needs

    N_k = N K (n_k e_k / gap)^2

trajectories, n_k e_k being twice the sum of what its n_k demonstrations add to the standard errors
of the two scores. What nothing here can see is a mode that no trajectory ever took: the weights of
the others are flawless.

Shapes: K tasks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from swerve.base.phrases import NUM_NAMES, some_names
from swerve.evidence.estimators import LOW_ESS
from swerve.evidence.evidence import Evidence
from swerve.evidence.samples import RESAMPLED, TEMPERED
from swerve.inference.ranking import TIE_ERRORS, Ranking

HIGH_KL = {  # nats, between policy and pi_0
    "smc": math.inf,
    "tempered": math.inf,
    "importance": 0.5,
    "plain": 0.1,
}
HIGH_SPREAD = 1.0  # nats: standard deviation of log Z_0 between islands
HOTTEST = 0.5  # of the beta drawn for: below it, weights of a Gaussian would have no variance
VALUE_GAP = {  # nats, between a solver's log Z_0 and its samples'
    "Grid(": 0.1,
    "SoftValue(": 1.0,
    "Distilled(": 2.0,
}
ADAPTING = ("Grid(", "SoftValue(")  # solvers that `resolve` can use
NUM_ERRORS = 3.0  # standard errors on top
GOOD_ESS_SHARE = 0.3  # above it the policy is not what is wrong
NUM_SETTLED = 3  # first hypotheses whose order is to be told
MOST_SAMPLES = 10_000_000  # beyond, sampling will not tell
FAR_BEHIND = 7.0  # nats, errors taken off: a thousand times less likely than the first


def warnings(inference: Ranking) -> Iterator[str]:
    """Yield what speaks against the samples, each kind once."""
    yield from _too_few(inference)
    yield from _apart(inference)
    yield from _too_hot(inference)
    yield from _far_policy(inference)
    yield from _wrong_value(inference)


def verdict(inference: Ranking, task: int) -> str:
    """Return how far the samples of a task can be trusted, in a few words."""
    evidence = inference.evidence
    if evidence.is_exact:
        return "exact"
    if _has_too_few(inference)[task]:
        left = f"{evidence.effective_sample_size[task]:.0f} of {evidence.num_trajectories}"
        other = f" at another beta: {_at_its_beta(evidence)}" if evidence.is_of_other_beta else ""
        return f"not to be trusted: effective sample size {left}{other}"
    if _is_apart(inference)[task]:
        spread = evidence.island_spread[task]
        return f"not to be trusted: parts of its samples differ by {spread:.1f} nats in log Z_0"
    if is_too_hot(evidence):
        return f"errors may be larger than stated: {_at_its_beta(evidence)}"
    if _is_far(inference)[task]:
        return f"errors may be larger than stated: KL {evidence.kl[task]:.2f} nats"
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
        return f"{text}, nor will more samples do it"
    return f"{text}: raise --samples to about {_round_up(needed.max()):,}"


def summary(inference: Ranking) -> str:
    """Return the verdicts of all tasks that are used, in a few lines."""
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
    """Return N_k of the module's formula for each gap between the first few.

    Infinite where a score hangs on a number that more samples do not change. Hypotheses that
    explain nothing, as far as can be told, need no order, nor do those far behind the first.
    """
    first = inference.ranking[: NUM_SETTLED + 1]
    evidence, num_tasks = inference.evidence, np.count_nonzero(inference.task_counts)
    score, error = inference.score[first], inference.task_error[task, first]
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
    """Return whether the samples of a task that is used are not to be trusted at all."""
    if inference.evidence.is_exact:
        return False
    return bool((_has_too_few(inference) | _is_apart(inference)).any())


def is_too_hot(evidence: Evidence) -> bool:
    """Return whether beta is so far below the one drawn for that weights cannot be believed.

    What is common at a low beta may be too rare at a high one to be drawn at all, which leaves no
    trace in the effective sample size.
    """
    return evidence.problem.beta < HOTTEST * evidence.sampling_beta


def _has_too_few(inference: Ranking) -> np.ndarray:
    """Return [K] whether a task that is used has too few effective samples."""
    return inference.evidence.has_too_few & (inference.task_counts > 0)


def _is_apart(inference: Ranking) -> np.ndarray:
    """Return [K] whether independent parts of a task's samples disagree on log Z_0."""
    used = (inference.task_counts > 0) & ~_has_too_few(inference)
    return used & (inference.evidence.island_spread > HIGH_SPREAD)


def _is_far(inference: Ranking) -> np.ndarray:
    """Return [K] whether the policy of a task is too far from pi_0."""
    used = (inference.task_counts > 0) & ~_has_too_few(inference)
    return used & (inference.evidence.kl > HIGH_KL[inference.evidence.method])


def _value_gap(inference: Ranking) -> np.ndarray:
    """Return [K] by how much more the solver's log Z_0 and its samples' differ than they may.

    Weights account for -log(ESS / N): where that share of trajectories survives a wall, say. For
    resampled trajectories of a grid they do not: there ESS is about ancestors. 0 for tasks that are
    not used, and where the solver has no value.
    """
    evidence = inference.evidence
    used = (inference.task_counts > 0) & ~_has_too_few(inference)
    share = evidence.effective_sample_size / evidence.num_trajectories
    error = np.sqrt(np.maximum(1.0 / share - 1.0, 0.0) / evidence.num_trajectories)  # of log Z_0
    if evidence.method in RESAMPLED and evidence.solver.startswith("Grid("):
        share, error = np.ones_like(share), evidence.log_partition_error
    explained = NUM_ERRORS * error - np.log(share)
    allowed = [value for solver, value in VALUE_GAP.items() if evidence.solver.startswith(solver)]
    gap = np.abs(evidence.soft_value - evidence.log_partition) - explained - max(allowed, default=0)
    return np.where(used & (gap > 0.0), gap, 0.0)


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
            f"{inference.task_name(worst)}, by {evidence.island_spread[worst]:.1f} nats). "
            f"{_remedy(evidence)}"
        )


def _too_hot(inference: Ranking) -> Iterator[str]:
    if is_too_hot(inference.evidence):
        yield (
            "errors may be larger than stated: what is common at a beta less than half of that "
            f"drawn for may be missing from the samples. {_remedy(inference.evidence)}"
        )


def _far_policy(inference: Ranking) -> Iterator[str]:
    """Yield that standard errors say nothing of what a policy far from pi_0 hardly ever does."""
    evidence, far = inference.evidence, _is_far(inference)
    if far.any():
        worst = int(np.where(far, evidence.kl, 0.0).argmax())
        cause = "what it hardly ever does may be missing from them"
        if evidence.method == "plain":
            cause = "plain weights take it for pi_0: use importance weights"
        yield (
            f"errors may be larger than stated: for {far.sum()} of "
            f"{np.count_nonzero(inference.task_counts)} tasks the policy is more than "
            f"{HIGH_KL[evidence.method]:g} nats from pi_0 (worst: {inference.task_name(worst)}, KL "
            f"{evidence.kl[worst]:.2f}), and {cause}. {_remedy(evidence)}"
        )


def _wrong_value(inference: Ranking) -> Iterator[str]:
    """Yield that the solver's own log Z_0 is not what its samples say."""
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
    """Return what to do about an effective sample size that is this share of N."""
    if evidence.is_of_other_beta:
        return (
            f"The trajectories were drawn for beta {evidence.sampling_beta:g}, and are weighed for "
            f"{evidence.problem.beta:g}: {_at_its_beta(evidence)}"
        )
    if evidence.method == TEMPERED:
        return (
            "Tempering has left too few: draw more trajectories, or learn at a beta nearer to "
            f"{evidence.problem.beta:g}"
        )
    if share > GOOD_ESS_SHARE:
        return f"Sample more trajectories: at least {LOW_ESS / share:.0f}"
    if evidence.solver.startswith("Grid("):
        text = "The grid is too coarse for this problem: give it more num_points"
        other = ", or take method 'importance', which does without values on the way"
        return text + other * (evidence.method == "smc")
    return (
        "The policy is far from pi_0 here: train it longer (num_steps), or use the grid solver "
        "where the state has at most 3 dimensions. Tasks unlike those of sample_task were never "
        "trained for. Where rewards are too sharp to be learned, learn for a lower beta and reach "
        "this one by temperatures between, in Python: swerve.sample(nominal, tasks, "
        f"beta={evidence.problem.beta:g})"
    )


def hardly_avoided(inference: Ranking) -> Iterator[str]:
    """Yield what scores hang on where next to no nominal trajectory avoids a hypothesis."""
    evidence, ranking = inference.evidence, inference.ranking
    used = ((inference.task_counts > 0) & ~_has_too_few(inference))[:, None]
    floored = evidence.is_floored & used
    in_vain = np.isposinf(evidence.summary.log_ratio_error) & used  # `resolve` did not settle them
    bounds = ranking[floored[:, ranking].any(axis=0)]
    if len(bounds):
        resolution = evidence.resolution[floored[:, bounds].any(axis=1)]
        text = (
            f"the score of {_names(bounds)} is only a lower bound: almost every nominal trajectory "
            "of a task enters it, and for each demonstration of such a task the samples tell no "
            f"more than about {-math.log(resolution.min()):.1f} nats"
        )
        if not evidence.solver.startswith(ADAPTING):
            text += ". With the solvers grid and soft-value more can be worked out"
        yield text + _in_vain(evidence) * bool((floored & in_vain).any())
    few = ranking[(in_vain & ~floored)[:, ranking].any(axis=0)]
    if len(few):
        yield (
            f"the score of {_names(few)} hangs on the two or three nominal trajectories of a task "
            "that avoid it: its error may be larger than stated"
        ) + _in_vain(evidence)


def _names(hypotheses: np.ndarray) -> str:
    return some_names([f"hypothesis {index}" for index in hypotheses])


def _in_vain(evidence: Evidence) -> str:
    """Return what to say where `swerve.resolve` has tried to put numbers to scores."""
    finer = "more num_points" if evidence.solver.startswith("Grid(") else "more num_steps"
    return (
        ". Working out what it takes to avoid it did not settle: sample more trajectories, give "
        f"the solver {finer}, or see whether anything the robot can do avoids it"
    )
