"""Stated errors are the spread over seeds, however trajectories, tasks and hypotheses depend."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from support.small_mdps import Stroll
from support.synthetic import copied, evidence_of_columns, make_demonstration, make_evidence

from swerve import Box, Evidence, Problem, Task, best_pair, greedy, grid, infer, learn, sample
from swerve.evidence.samples import NUM_ISLANDS
from swerve.solvers.base import Nominal

NUM_SEEDS = 50


@pytest.fixture(scope="module")
def walk() -> Nominal:
    return learn(Problem(Stroll(), [Box(x=(0.8, 4.0)), Box(x=(-4.0, -0.9))]), "grid?num_points=31")


@pytest.mark.parametrize("num_copies", [1, 10])
def test_pairs_are_as_uncertain_as_copies_of_few_trajectories(num_copies: int) -> None:
    """Errors that took copies for independent would be less than a third of the spread."""
    found = [
        best_pair(infer(copied(seed, num_copies), [make_demonstration()]))
        for seed in range(NUM_SEEDS)
    ]
    assert all(pair.hypotheses == (5, 7) for pair in found)
    spread = np.std([pair.log_likelihood for pair in found], ddof=1)
    error = np.mean([pair.standard_error for pair in found])
    assert 0.75 < error / spread < 1.35


@pytest.mark.parametrize("num_copies", [1, 10])
@pytest.mark.parametrize("share", [0.5, 1.0])
def test_a_pair_with_what_nobody_enters_is_the_hypothesis_alone(
    num_copies: int, share: float
) -> None:
    """With the same error, and where nobody avoids the hypothesis, with the same bound."""
    evidence = copied(0, num_copies)
    bits = evidence.samples.violations.copy()
    bits[0, : int(800 * share), 0] |= 1 << 5
    bits[0, :, 0] &= 0xFF ^ (1 << 7)  # 7 is entered by nobody
    evidence = make_evidence(
        evidence.problem, evidence.samples._replace(violations=bits), evidence.tasks
    )
    inference = infer(evidence, [make_demonstration(), make_demonstration()])
    pair = best_pair(inference)
    assert 5 in pair.hypotheses
    assert pair.log_likelihood == pytest.approx(inference.log_likelihood[5], rel=1e-12)
    assert pair.standard_error == pytest.approx(inference.standard_error[5], rel=1e-9)
    if share == 1.0:
        bound = 2.0 * math.log(800 / num_copies)
        assert inference.log_likelihood[5] == pytest.approx(bound, rel=1e-12)


def test_a_pair_counts_what_resolving_worked_out() -> None:
    evidence = copied(0, 1)
    log_ratio, error = (x.copy() for x in (evidence.log_ratio, evidence.standard_error))
    log_ratio[0, 3], error[:], error[0, 3] = -40.0, np.nan, 0.05
    avoid = evidence.summary.avoid_probability.copy()
    avoid[0, 3] = np.exp(-40.0)
    summary = evidence.summary._replace(
        avoid_probability=avoid, log_ratio=log_ratio, log_ratio_error=error
    )
    inference = infer(dataclasses.replace(evidence, summary=summary), [make_demonstration()])
    pair = best_pair(inference)
    assert 3 in pair.hypotheses
    assert (pair.log_likelihood, pair.standard_error) == (40.0, 0.05)
    by_samples = inference.evidence.avoid_probability_by_samples(0)
    np.testing.assert_allclose(by_samples, evidence.summary.avoid_probability[0], atol=1e-12)


@pytest.mark.parametrize("num_copies", [1, 10])
def test_a_later_pick_is_bounded_by_what_few_ancestors_tell(num_copies: int) -> None:
    """After 5 about half of the trajectories are left: their ancestors bound what all enter."""
    evidence = copied(3, num_copies)
    bits = evidence.samples.violations.copy()
    left = bits[0, :, 0] & (1 << 5) == 0
    bits[0, left, 0] |= 1 << 6
    samples = evidence.samples._replace(violations=bits)
    evidence = make_evidence(evidence.problem, samples, evidence.tasks)
    first, second = greedy(infer(evidence, [make_demonstration()]), threshold=0.1, most=2)
    assert {first.hypothesis, second.hypothesis} == {5, 6}
    of_first = np.bitwise_and(bits[0, :, 0], 1 << first.hypothesis) == 0
    num_ancestors = len(np.unique(samples.ancestor[0, of_first]))
    assert second.gain == pytest.approx(math.log(num_ancestors))
    assert second.standard_error == 1.0


class TestEqualTasks:
    """A task given twice has the same trajectories; tasks that differ have their own."""

    START, GOAL = 0.0, 0.0

    def tasks(self, step: float, num: int = 9) -> list[Task]:
        return [Task([self.START], [self.GOAL + step * k]) for k in range(num)]

    @pytest.mark.parametrize("step", [0.0, 0.001])
    def test_errors_are_the_spread_over_seeds(self, walk: Nominal, step: float) -> None:
        """Taken for independent, nine that are one task would be stated a third of the spread."""
        found = [infer(sample(walk, self.tasks(step), 200, seed=seed)) for seed in range(16)]
        spread = np.std([one.score[0] for one in found], ddof=1)
        error = np.mean([one.score_error[0] for one in found])
        assert 0.6 < error / spread < 1.7

    def test_errors_of_the_same_add_up(self, walk: Nominal) -> None:
        once = sample(walk, self.tasks(0.0, 1), 300)
        three = sample(walk, [*self.tasks(0.0, 2), Task([-0.0], [-0.0])], 300)
        np.testing.assert_array_equal(three.samples.violations, [once.samples.violations[0]] * 3)
        for many in (three, once.joined(once, once)):
            np.testing.assert_array_equal(many.sample_of, [0, 0, 0])
            for score in ("likelihood", "average"):
                one, all_three = (infer(evidence, score=score) for evidence in (once, many))
                factor = 3.0 if score == "likelihood" else 1.0
                np.testing.assert_allclose(all_three.score, factor * one.score)
                np.testing.assert_allclose(all_three.score_error, factor * one.score_error)
                np.testing.assert_allclose(all_three.standard_error, 3.0 * one.standard_error)

    def test_demonstrations_of_a_task_share_its_errors(self) -> None:
        evidence = copied(0, 1)
        one, three = (infer(evidence, [make_demonstration()] * num) for num in (1, 3))
        np.testing.assert_allclose(three.standard_error, 3.0 * one.standard_error)
        ones, threes = (greedy(found, threshold=0.01) for found in (one, three))
        errors = [[pick.standard_error for pick in picks] for picks in (ones, threes)]
        np.testing.assert_allclose(errors[0], errors[1])  # of the gain per demonstration
        pairs = [best_pair(found).standard_error for found in (one, three)]
        assert pairs[1] == pytest.approx(3.0 * pairs[0])

    def test_tasks_that_differ_are_independent(self, walk: Nominal) -> None:
        evidence = sample(walk, self.tasks(1e-12, 4), 300)
        assert len(np.unique(evidence.sample_of)) == 4
        assert len(np.unique(evidence.samples.violations[:, :, 0], axis=0)) == 4
        error = np.linalg.norm(evidence.standard_error, axis=0)
        np.testing.assert_allclose(infer(evidence).score_error, error)


def resolved(seed: int, num_resolved: int) -> Evidence:
    """Two cells by the samples, others resolved: Z_c is known, Z_0 by the islands' weights."""
    generator = np.random.default_rng(seed)
    columns = np.zeros((1, 800, 10), bool)
    columns[0, :, 9] = generator.random(800) < 0.4
    evidence = evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)), "importance")
    scale = generator.normal(0.0, 0.4, NUM_ISLANDS).repeat(800 // NUM_ISLANDS)
    samples = evidence.samples._replace(log_correction=scale[None])
    evidence = make_evidence(evidence.problem, samples, evidence.tasks)
    ratio, error = (x.copy() for x in (evidence.log_ratio, evidence.standard_error))
    start, num_actions, length = evidence.log_partition[0], 3, 5
    ratio[0, 2 : 2 + num_resolved] = -1.5 - length * math.log(num_actions) - start
    error[:] = np.nan
    error[0, 2 : 2 + num_resolved] = evidence.log_partition_error[0]
    summary = evidence.summary._replace(log_ratio=ratio, log_ratio_error=error)
    return dataclasses.replace(evidence, summary=summary)


@pytest.mark.parametrize("num_resolved", [1, 6])
def test_ratios_that_were_resolved_share_the_error_of_z_0(num_resolved: int) -> None:
    """Six errors taken for independent would be stated less than half of the spread."""
    demonstrations = [make_demonstration()] * 2
    found = [infer(resolved(seed, num_resolved), demonstrations) for seed in range(NUM_SEEDS)]
    spread = np.std([one.posterior.none for one in found], ddof=1)
    stated = np.sqrt(np.mean([one.posterior.none_error**2 for one in found]))
    assert 0.75 < stated / spread < 1.35
