"""Estimates and inference from weighted trajectories are the formulas, computed anew."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from brute_force.chunks import CHUNKS, over
from brute_force.comparing import (
    Differences,
    compare_evidence,
    compare_greedy,
    compare_inference,
    compare_pair,
)
from brute_force.reference.answers import Answer
from brute_force.reference.cases import Case, random_case
from brute_force.reference.demonstrated import BetaLikelihood, earned
from brute_force.sampled_evidence import NUM, Sampled, evidence_of, record_of, sampled
from brute_force.translation import demonstrations_of, inferred, problem_of

from swerve import Evidence, Problem, fit_beta, hoeffding_error, hoeffding_sample_size

CLOSE = 1e-7  # sums in float64


def compared(seed: int) -> list[str]:
    case, note = random_case(seed), Differences(seed, CLOSE)
    sample = sampled(case, seed)
    evidence = evidence_of(case, sample, record_of(case))
    truth = Answer(case, sample.tasks(case, case.beta))
    compare_evidence(note, evidence, truth)
    _sizes_and_errors(note, evidence, truth)
    inference = inferred(case, evidence)
    compare_inference(note, inference, truth)
    if case.recordings:
        options = ({"most": 2}, {}, {"threshold": 0.05}, {"odds": 2.0, "threshold": 0.0})[seed % 4]
        compare_greedy(note, inference, replace(truth, in_turn=True), None, **options)
        compare_pair(note, inference, truth, None)
    _at_another_beta(note, case, sample, evidence, seed)
    _plainly(note, case, sample)
    return note.found


def _sizes_and_errors(note: Differences, evidence: Evidence, truth: Answer) -> None:
    effective = [task.effective for task in truth.tasks]
    note.numbers("effective_sample_size", evidence.effective_sample_size, effective)
    kl = [task.log_partition - task.log_weight.mean() for task in truth.tasks]
    note.numbers("kl", evidence.kl, kl)
    for k, task in enumerate(truth.tasks):
        weight = np.exp(task.log_weight - task.log_weight.max())
        weight /= weight.sum()
        avoid, least = truth.avoid_probability[k], 1.0 / task.effective
        off = ~task.entered - avoid
        error = np.sqrt((weight[:, None] ** 2 * off**2).sum(axis=0))
        relative = np.maximum(error / np.maximum(avoid, least), least)
        expected = np.where(avoid < least, 1.0, relative)
        note.numbers(f"standard_error[{k}]", evidence.standard_error[k], expected, 1e-6)


def _at_another_beta(
    note: Differences, case: Case, sample: Sampled, evidence: Evidence, seed: int
) -> None:
    """Theorem 2: the same trajectories weighed for another beta."""
    beta = case.beta * (0.8, 1.2)[seed % 2]
    note.seed = seed
    compare_evidence(note, evidence.at_beta(beta), Answer(case, sample.tasks(case, beta)))


def _plainly(note: Differences, case: Case, sample: Sampled) -> None:
    """The paper's estimates: all weights equal, and then R to another beta."""
    plain = evidence_of(case, sample, record_of(case), "plain")
    note.numbers("plain", plain.violation_probability, sample.entered.mean(axis=1))
    note.numbers("hoeffding", plain.hoeffding_error(0.9), math.sqrt(math.log(20.0) / (2 * NUM)))
    weight = np.exp(0.1 * case.beta * (sample.reward - sample.reward.max(axis=1, keepdims=True)))
    weight /= weight.sum(axis=1, keepdims=True)
    expected = np.einsum("kn,knh->kh", weight, sample.entered)
    found = plain.at_beta(1.1 * case.beta).violation_probability
    note.numbers("plain at another beta", found, expected)
    again = plain.weighted("importance")
    effective = [task.effective for task in sample.tasks(case, case.beta)]
    note.numbers("weighted", again.effective_sample_size, effective)


@pytest.mark.parametrize("seeds", CHUNKS, ids=str)
def test_estimates_and_what_follows(seeds: range) -> None:
    over(seeds, compared)


def test_hoeffding_bounds() -> None:
    for num, confidence in itertools.product((1, 100, 10_000), (0.5, 0.95, 0.999)):
        error = hoeffding_error(num, confidence)
        assert 2.0 * math.exp(-2.0 * num * error**2) == pytest.approx(1.0 - confidence)
        if error < 1.0:
            assert abs(hoeffding_sample_size(error * (1 + 1e-9), confidence) - num) <= 1


def beta_compared(seed: int) -> list[str]:
    case, note = random_case(seed, "smooth"), Differences(seed, CLOSE)
    problem, sample = problem_of(case), sampled(case, seed)
    effective = [task.effective for task in sample.tasks(case, case.beta)]
    if case.recordings and min(effective) > 110.0:
        _compare_fit(note, problem, case, sample)
    return note.found


def _compare_fit(note: Differences, problem: Problem, case: Case, sample: Sampled) -> None:
    """Compare beta, its interval, and where the samples do not tell beta."""
    truth, demonstrations = _likelihood(case, sample), demonstrations_of(case)
    evidence = evidence_of(case, sample, problem.record)
    try:
        found = fit_beta(problem, evidence, demonstrations, 0.9)
    except ValueError as error:
        where = re.search(r"greatest (below|above) beta ([\d.e+-]+),", str(error))
        if where is None:
            raise
        slope = truth.slope(float(where[2])) * (1.0 if where[1] == "above" else -1.0)
        note.true(f"fit_beta: {error}, but the slope there is {slope}", slope > -1e-2)
        return
    if found.at_boundary:
        far, sign = (0.0, -1.0) if found.beta == 0.0 else (1e3 * case.beta, 1.0)
        note.true(f"fit_beta: {found.beta}", sign * truth.slope(far) > -1e-3)
        return
    best = truth.best(*found.trusted)
    note.numbers("fit_beta.beta", found.beta, best, 1e-4)
    drop = 0.5 * NormalDist().inv_cdf(0.95) ** 2
    for got, end in zip(found.interval, found.trusted, strict=True):
        if 0.0 < got < math.inf:
            note.numbers("fit_beta.interval", got, truth.fallen(best, end, drop), 1e-3)
        else:
            falls = truth.value(best) - truth.value(end)
            note.true(f"fit_beta.interval {found.interval}: falls {falls}", falls < drop + 1e-3)


def _likelihood(case: Case, sample: Sampled) -> BetaLikelihood:
    tasks, counts = np.unique(case.task_of, return_counts=True)
    base = sample.log_weight(case, 0.0)
    total = sum(earned(case, recording)[0] for recording in case.recordings)
    return BetaLikelihood(
        [sample.reward[k] for k in tasks], [base[k] for k in tasks], counts.tolist(), total
    )


@pytest.mark.parametrize("seeds", CHUNKS, ids=str)
def test_beta_of_maximum_likelihood(seeds: range) -> None:
    over(range(seeds.start, seeds.stop, 5), beta_compared)
