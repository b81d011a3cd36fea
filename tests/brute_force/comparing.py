"""Hold the library's numbers against the reference's; what differs is put on a list.

Shapes: K tasks, H hypotheses, D demonstrations.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from brute_force.reference.answers import Answer
from brute_force.translation import demonstrations_of

from swerve import Inference, Pair, Pick, best_pair, greedy
from swerve.evidence.evidence import Evidence


class Differences:
    """What differs between the library and the reference.

    Attributes:
      close: relative and absolute difference up to which numbers are the same: float32 sums in
        simulated rewards, float64 elsewhere.
      found: the differences, one line each.
    """

    def __init__(self, seed: int, close: float) -> None:
        self.seed, self.close = seed, close
        self.found: list[str] = []

    def numbers(self, what: str, got: Any, expected: Any, close: float | None = None) -> None:
        """Note numbers that differ; infinities and shapes must agree as well."""
        got, expected = np.asarray(got, float), np.asarray(expected, float)
        close = self.close if close is None else close
        if got.shape != expected.shape:
            self.note(f"{what}: shape {got.shape}, expected {expected.shape}")
        elif not np.allclose(got, expected, rtol=close, atol=close, equal_nan=True):
            far = ~np.isclose(got, expected, rtol=close, atol=close, equal_nan=True)
            place = tuple(int(k) for k in np.argwhere(far)[0])
            self.note(f"{what}{list(place)}: {got[far][0]!r}, expected {expected[far][0]!r}")

    def same(self, what: str, got: Any, expected: Any) -> None:
        """Note values that are not equal."""
        if not np.array_equal(np.asarray(got), np.asarray(expected)):
            self.note(f"{what}: {got}, expected {expected}")

    def true(self, what: str, holds: bool) -> None:
        """Note what does not hold."""
        if not holds:
            self.note(what)

    def note(self, text: str) -> None:
        """Put a difference on the list."""
        self.found.append(f"seed {self.seed}: {text}")


def compare_evidence(note: Differences, evidence: Evidence, answer: Answer) -> None:
    """Compare log Z_0 and Z_c / Z_0 of every task."""
    expected = [task.log_partition for task in answer.tasks]
    note.numbers("log_partition", evidence.log_partition, expected)
    note.numbers("log_ratio", evidence.log_ratio, answer.log_ratio)
    violation = 1.0 - answer.avoid_probability
    note.numbers("violation_probability", evidence.violation_probability, violation)


def compare_inference(note: Differences, inference: Inference, answer: Answer) -> None:
    """Compare everything that an inference says in numbers."""
    case = answer.case
    if case.recordings:
        note.same("entered", inference.entered, case.judged)
        note.same("task_of", inference.task_of, case.task_of)
        _contributions(note, inference, answer)
    note.same("is_counted", inference.is_counted, case.is_counted)
    note.same("struck_out", inference.struck_out, answer.struck_out)
    note.numbers("log_likelihood", inference.log_likelihood, answer.log_likelihood)
    note.numbers("score", inference.score, answer.score)
    note.numbers("average_violation", inference.average_violation, answer.average_violation)
    note.numbers("log_bayes_factor", inference.log_bayes_factor, answer.log_bayes_factor)
    _ranking(note, inference, answer)
    _posterior(note, inference, answer)


def _contributions(note: Differences, inference: Inference, answer: Answer) -> None:
    """Compare what each demonstration adds, where its hypothesis is not ruled out by nobody."""
    eps, case = answer.case.assumed.tolerance, answer.case
    with np.errstate(divide="ignore"):
        ratio = eps + (1.0 - eps) * np.exp(-answer.log_ratio[case.task_of])
        terms = np.where(case.judged, np.log(eps), np.log(ratio))
    expected = np.where(case.is_counted[case.task_of], terms, 0.0)
    left = ~answer.impossible
    note.numbers("contributions", inference.contributions[:, left], expected[:, left])


def _ranking(note: Differences, inference: Inference, answer: Answer) -> None:
    """Compare the order, up to scores that are the same."""
    ranking = inference.ranking
    note.same("ranked", np.sort(ranking), np.flatnonzero(~answer.struck_out))
    scores = answer.score[ranking]
    slack = note.close * (1.0 + np.abs(scores[1:]))
    note.true("ranking is not in order of the score", bool((np.diff(scores) <= slack).all()))
    rank = inference.rank
    for k in range(1, len(scores)):
        if inference.score_error[ranking].any():
            break  # ties within sampling errors have tests of their own
        if scores[0] - scores[k] > 10 * note.close * (1.0 + abs(scores[0])):
            note.true(f"rank {rank[k]} of hypothesis {ranking[k]} is the first", rank[k] > 1)


def _posterior(note: Differences, inference: Inference, answer: Answer) -> None:
    expected = answer.posterior
    note.same("is_ruled_out", inference.is_ruled_out, expected is None)
    if expected is None or inference.is_ruled_out:
        return
    found = inference.posterior
    note.numbers("posterior", np.r_[found.none, found.hypotheses], expected)
    for least in (0.5, 0.9, 0.95):
        chosen = inference.credible_set(least)
        members = [0] * chosen.has_none + (1 + chosen.hypotheses).tolist()
        total = expected[members].sum()
        note.numbers("credible_set.probability", chosen.probability, min(total, 1.0), 1e-4)
        fewest = [
            int(np.searchsorted(np.cumsum(np.sort(expected)[::-1]), least + shift) + 1)
            for shift in (-1e-4, 1e-4)
        ]
        size = f"credible_set({least}) has {len(members)} answers, expected {fewest}"
        note.true(size, fewest[0] <= len(members) <= fewest[1])


def compare_least_tolerance(note: Differences, inference: Inference, answer: Answer) -> None:
    """Compare the least tolerance for which a hypothesis beats no constraint."""
    if not answer.case.recordings:
        return
    got, expected = inference.least_tolerance, answer.least_tolerance()
    if got is None or expected is None:
        note.true(f"least_tolerance: {got}, expected {expected}", got == expected)
    else:
        note.numbers("least_tolerance", math.log(got), math.log(expected), 5e-3)


def compare_greedy(
    note: Differences, inference: Inference, answer: Answer, nominal: Any, **options: Any
) -> None:
    """Follow the picks one after another: each is the best, and the last is where picking ends."""
    picks = greedy(inference, nominal, **options)
    threshold, odds = options.get("threshold"), options.get("odds")
    least = max(threshold or 0.0, 1e-9)
    is_by_odds = threshold is None or odds is not None
    picked: list[int] = []
    for pick in picks:
        _compare_pick(note, pick, answer, picked, odds)
        picked.append(pick.hypothesis)
        where = f"greedy: pick {picked} gains {pick.gain}, log odds {pick.log_odds}"
        note.true(where, pick.gain > least - note.close)
        note.true(where, not is_by_odds or pick.log_odds > -note.close)
    gain = answer.gains(picked).max() / len(answer.case.recordings)
    is_last = gain < least + 10 * note.close or len(picks) == options.get("most")
    if is_by_odds:
        is_last |= answer.log_odds(picked, odds) < 10 * note.close
    note.true(f"greedy ends after {picked} where one more gains {gain}", is_last)


def _compare_pick(
    note: Differences, pick: Pick, answer: Answer, picked: list[int], odds: float | None
) -> None:
    gains = answer.gains(picked)
    gain, case = gains[pick.hypothesis], answer.case
    where = f"greedy {[*picked, pick.hypothesis]}"
    note.numbers(f"{where}.total_gain", pick.total_gain, gain)
    note.numbers(f"{where}.gain", pick.gain, gain / len(case.recordings))
    best = gains.max()
    note.true(
        f"{where}: {gain} is not the best, {best}", gain > best - note.close * (1 + abs(best))
    )
    note.numbers(f"{where}.log_odds", pick.log_odds, answer.log_odds(picked, odds))
    for k, task in enumerate(answer.tasks):
        if answer.counts[k]:
            together = answer.counting(k, [*picked, pick.hypothesis])
            expected = task.log_partition + answer.log_share(k, together)
            note.numbers(f"{where}.log_partition[{k}]", pick.log_partition[k], expected)


def compare_pair(note: Differences, inference: Inference, answer: Answer, nominal: Any) -> None:
    """Compare the best of all pairs."""
    left = np.flatnonzero(~answer.struck_out).tolist()
    value = {(a, b): answer.log_likelihood_of([a, b]) for a in left for b in left if a < b}
    value = {pair: x for pair, x in value.items() if math.isfinite(x)}
    try:
        found: Pair | None = best_pair(inference, nominal)
    except ValueError as error:
        found = None
        note.true(f"best_pair: {error}, expected one of {value}", not value)
    if found is None or not value:
        note.true(f"best_pair: {found}, expected none", found is None)
        return
    expected = value.get(found.hypotheses, math.nan)
    best = max(value.values())
    note.numbers(f"best_pair {found.hypotheses}", found.log_likelihood, expected)
    slack = note.close * (1.0 + abs(best))
    note.true(f"best_pair {found}: {best} is better", expected > best - slack)


def compare_one_by_one(
    note: Differences, empty: Inference, together: Inference, answer: Answer
) -> None:
    """Compare an inference to which demonstrations are added one after another."""
    added = empty
    for demonstration in demonstrations_of(answer.case):
        added = added.add(demonstration)
    note.numbers("add", added.log_likelihood, together.log_likelihood, 0.0)
    note.same("add: task_of", added.task_of, together.task_of)
