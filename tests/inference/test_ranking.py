"""Likelihood ratios, ties and the order of hypotheses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.rankings import CELLS, RISING, evidence_with_chances
from support.synthetic import (
    TASKS,
    evidence_of_columns,
    make_demonstration,
    make_evidence,
    make_record,
    make_samples,
)

from swerve.answer import infer
from swerve.base.space import TWO_PI, Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.grid import grid

seeds = st.integers(0, 2**32 - 1)


class TestStruckOut:
    def test_what_a_demonstration_enters_is_struck_out(self) -> None:
        demonstrations = [make_demonstration(0, "a", x=3.5), make_demonstration(1, "b")]
        result = infer(evidence_with_chances(RISING), demonstrations)
        np.testing.assert_array_equal(np.flatnonzero(result.struck_out), [1, 3, 5])
        np.testing.assert_array_equal(np.flatnonzero(result.entered[0]), [1, 3])
        np.testing.assert_array_equal(np.flatnonzero(result.entered[1]), [5])
        assert np.isneginf(result.log_likelihood[[1, 3, 5]]).all()
        assert np.isfinite(np.delete(result.log_likelihood, [1, 3, 5])).all()
        np.testing.assert_array_equal(result.ranking, [9, 8, 7, 6, 4, 2, 0])

    def test_demonstrations_of_different_lengths_are_judged_apart(self) -> None:
        record = make_record(hypotheses=CELLS, between_states=True)
        evidence = make_evidence(record, make_samples(num_hypotheses=10))
        task = Task(TASKS.start[0], TASKS.goal[0])
        paths = [np.array([[0.1, x] for x in way]) for way in ([1.0, 4.5], [1.0, 0.5, 1.5, 2.5])]
        result = infer(evidence, [Demonstration("a", path, task) for path in paths])
        np.testing.assert_array_equal(np.flatnonzero(result.entered[0]), [1, 2, 3, 4])
        np.testing.assert_array_equal(np.flatnonzero(result.entered[1]), [0, 1, 2])

    @pytest.mark.parametrize("between_states", [True, False])
    def test_segments_count_if_the_problem_says_so(self, between_states: bool) -> None:
        record = make_record(hypotheses=CELLS, between_states=between_states)
        evidence = make_evidence(record, make_samples(num_hypotheses=10))
        result = infer(evidence, [make_demonstration(0, x=4.5)])
        expected = [1, 2, 3, 4] if between_states else [1, 4]
        np.testing.assert_array_equal(np.flatnonzero(result.struck_out), expected)

    def test_without_demonstrations_none_is(self) -> None:
        result = infer(evidence_with_chances(RISING))
        assert not result.struck_out.any()
        assert result.entered.shape == (0, 10)
        assert len(result.ranking) == 10


class TestLogLikelihood:
    def test_is_minus_the_log_ratio_of_the_task(self) -> None:
        evidence = evidence_with_chances(RISING)
        for task in range(3):
            result = infer(evidence, [make_demonstration(task)])
            left = ~result.struck_out
            np.testing.assert_array_equal(result.task_of, [task])
            np.testing.assert_allclose(
                result.log_likelihood[left], -np.log(1.0 - np.array(RISING))[left], atol=1e-12
            )
            np.testing.assert_allclose(result.log_likelihood[left], -evidence.log_ratio[task][left])
            expected = np.where(left, evidence.standard_error[task], 0.0)  # -inf has no error
            np.testing.assert_allclose(result.standard_error, expected)

    @given(
        seed=seeds,
        tasks=st.lists(st.integers(0, 2), min_size=1, max_size=6),
        split=st.integers(0, 6),
    )
    @settings(max_examples=40)
    def test_adds_over_demonstrations(self, seed, tasks, split) -> None:
        evidence = make_evidence(
            make_record(hypotheses=CELLS), make_samples(80, num_hypotheses=10, seed=seed)
        )
        demonstrations = [make_demonstration(task, f"d{k}") for k, task in enumerate(tasks)]
        together = infer(evidence, demonstrations)
        alone = [infer(evidence, [d]) for d in demonstrations]
        np.testing.assert_allclose(
            together.log_likelihood, np.sum([one.log_likelihood for one in alone], axis=0)
        )
        np.testing.assert_array_equal(
            together.struck_out, np.any([one.struck_out for one in alone], axis=0)
        )
        parts = [demonstrations[:split], demonstrations[split:]]
        if all(parts):
            two = [infer(evidence, part).log_likelihood for part in parts]
            np.testing.assert_allclose(together.log_likelihood, two[0] + two[1])

    @given(seed=seeds, tasks=st.lists(st.integers(0, 2), min_size=2, max_size=7))
    @settings(max_examples=40)
    def test_order_of_demonstrations_does_not_matter(self, seed, tasks) -> None:
        generator = np.random.default_rng(seed)
        evidence = evidence_with_chances(RISING, num=100, seed=seed)
        demonstrations = [
            make_demonstration(task, f"d{k}", x=generator.uniform(0, 10))
            for k, task in enumerate(tasks)
        ]
        shuffled = [demonstrations[k] for k in generator.permutation(len(tasks))]
        a, b = infer(evidence, demonstrations), infer(evidence, shuffled)
        for name in ("log_likelihood", "standard_error", "average_violation", "ranking", "rank"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert a.headline == b.headline

    @given(seed=seeds)
    @settings(max_examples=20)
    def test_order_of_hypotheses_does_not_matter(self, seed) -> None:
        generator = np.random.default_rng(seed)
        order = generator.permutation(10)
        samples = make_samples(80, num_hypotheses=10, seed=seed)
        columns = unpack(samples.violations, 10)
        a = evidence_of_columns(columns, grid(theta=(0.0, TWO_PI, 10)))
        b = evidence_of_columns(columns[..., order], grid(theta=(0.0, TWO_PI, 10)))
        np.testing.assert_allclose(
            infer(a).log_likelihood[order], infer(b).log_likelihood, atol=1e-12
        )
        np.testing.assert_allclose(
            infer(a).standard_error[order], infer(b).standard_error, atol=1e-12
        )

    def test_the_error_of_one_task_grows_with_its_demonstrations(self) -> None:
        """They share the samples: three have three times the error, not sqrt(3) times."""
        evidence = evidence_with_chances(RISING)
        once = infer(evidence, [make_demonstration(1)])
        thrice = infer(evidence, [make_demonstration(1, name) for name in "abc"])
        np.testing.assert_allclose(thrice.standard_error, 3.0 * once.standard_error)
        np.testing.assert_allclose(thrice.log_likelihood, 3.0 * once.log_likelihood)
        np.testing.assert_array_equal(thrice.task_counts, [0, 3, 0])

    def test_errors_of_different_tasks_are_independent(self) -> None:
        evidence = evidence_with_chances(RISING)
        result = infer(evidence, [make_demonstration(k, f"d{k}") for k in (0, 0, 2)])
        expected = np.sqrt(4 * evidence.standard_error[0] ** 2 + evidence.standard_error[2] ** 2)
        expected = np.where(result.struck_out, 0.0, expected)
        np.testing.assert_allclose(result.standard_error, expected)
        np.testing.assert_array_equal(result.task_counts, [2, 0, 1])

    def test_the_standard_error_is_the_spread_over_repeated_samples(self) -> None:
        """Two demonstrations of one task, one of another, with importance weights."""
        record = make_record(hypotheses=CELLS)
        demonstrations = [make_demonstration(k, f"d{n}") for n, k in enumerate([0, 0, 2])]
        results = [
            infer(
                make_evidence(record, make_samples(300, num_hypotheses=10, seed=seed)),
                demonstrations,
            )
            for seed in range(300)
        ]
        some = [2, 3, 4, 6]
        spread = np.std([r.log_likelihood[some] for r in results], axis=0)
        error = np.sqrt(np.mean([r.standard_error[some] ** 2 for r in results], axis=0))
        np.testing.assert_allclose(error, spread, rtol=0.2)


class TestRanking:
    def test_what_is_entered_most_often_comes_first(self) -> None:
        chances = [0.3, 0.0, 0.9, 0.1, 0.0, 0.5, 0.95, 0.2, 0.4, 0.0]
        result = infer(evidence_with_chances(chances), [make_demonstration(0)])
        # starts in cell 1; equal scores come in order of index
        np.testing.assert_array_equal(result.ranking, [6, 2, 5, 8, 0, 7, 3, 4, 9])
        np.testing.assert_array_equal(result.rank, [1, 2, 3, 4, 5, 6, 7, 8, 8])
        np.testing.assert_array_equal(result.leaders, [6])

    def test_equal_scores_come_in_order_of_index(self) -> None:
        quarters = np.random.default_rng(0).integers(0, 4, 100)
        columns = np.broadcast_to(np.arange(64)[:, None] < 16 * quarters, (3, 64, 100))
        result = infer(evidence_of_columns(columns, grid(x=(0.0, 10.0, 100))))
        np.testing.assert_array_equal(result.ranking, np.lexsort((np.arange(100), -quarters)))

    def test_identical_columns_tie(self) -> None:
        columns = np.random.default_rng(0).random((3, 500, 10)) < np.array(RISING)
        columns[..., 8] = columns[..., 9]
        columns[..., 4] = columns[..., 3]
        result = infer(evidence_of_columns(columns, CELLS), [make_demonstration(0)])
        assert set(result.leaders) >= {8, 9}
        rank = dict(zip(result.ranking.tolist(), result.rank.tolist(), strict=True))
        assert rank[8] == rank[9] == 1
        assert rank[3] == rank[4]

    def test_clear_differences_do_not(self) -> None:
        result = infer(evidence_with_chances([0.1 * k for k in range(10)]))
        np.testing.assert_array_equal(result.ranking, np.arange(9, -1, -1))
        np.testing.assert_array_equal(result.rank, np.arange(1, 11))

    def test_ties_are_within_twice_the_sum_of_the_errors(self) -> None:
        """Each group is measured from its first, so that no chain of ties reaches far."""
        result = infer(evidence_with_chances(np.linspace(0.4, 0.58, 10), num=500))
        score, error = result.log_likelihood[result.ranking], result.standard_error[result.ranking]
        assert len(set(result.rank)) > 1
        for k, rank in enumerate(result.rank):
            first = rank - 1
            assert score[first] - score[k] <= 2.0 * (error[first] + error[k])
            if rank == k + 1 and k > 0:
                before = result.rank[k - 1] - 1
                assert score[before] - score[k] > 2.0 * (error[before] + error[k])

    def test_few_trajectories_leave_more_ties(self) -> None:
        chances = np.linspace(0.0, 0.9, 10)
        many, few = (infer(evidence_with_chances(chances, num=n)) for n in (10_000, 20))
        np.testing.assert_array_equal(many.rank, np.arange(1, 11))
        assert len(few.leaders) > 1

    def test_more_demonstrations_of_one_task_do_not_undo_a_tie(self) -> None:
        """Their errors are the same ones: the scores of a tie grow apart as fast as these."""
        evidence = evidence_with_chances(np.linspace(0.4, 0.58, 10), num=500)
        one, many = (infer(evidence, [make_demonstration(0)] * n) for n in (1, 50))
        np.testing.assert_array_equal(one.ranking, many.ranking)
        np.testing.assert_array_equal(one.rank, many.rank)

    def test_the_prior_ranking_is_over_all_tasks(self) -> None:
        evidence = make_evidence(make_record(hypotheses=CELLS), make_samples(num_hypotheses=10))
        result = infer(evidence)
        np.testing.assert_array_equal(result.task_counts, [1, 1, 1])
        np.testing.assert_allclose(result.log_likelihood, -evidence.log_ratio.sum(axis=0))
        np.testing.assert_array_equal(result.ranking, np.argsort(evidence.log_ratio.sum(axis=0)))
        assert "this is the prior ranking" in result.headline
        assert result.to_json()["num_demonstrations"] == 0


class TestAverageScore:
    def test_is_the_violation_probability_averaged_over_demonstrations(self) -> None:
        evidence = make_evidence(
            make_record(hypotheses=CELLS), make_samples(200, num_hypotheses=10), method="plain"
        )
        demonstrations = [make_demonstration(k, f"d{n}") for n, k in enumerate([0, 2, 2])]
        result = infer(evidence, demonstrations, score="average")
        violation = unpack(evidence.samples.violations, 10).mean(axis=1)
        expected = (violation[0] + 2.0 * violation[2]) / 3.0
        np.testing.assert_allclose(result.average_violation, expected, atol=1e-12)
        variance = violation * (1.0 - violation) / 200
        error = np.sqrt(variance[0] + 4.0 * variance[2]) / 3.0
        np.testing.assert_allclose(result.score_error, error, atol=1e-12)
        left = ~result.struck_out
        np.testing.assert_array_equal(result.score[left], result.average_violation[left])
        assert np.isneginf(result.score[~left]).all()
        np.testing.assert_array_equal(result.ranking, np.argsort(-result.score)[: left.sum()])

    def test_tasks_that_say_nothing_of_a_hypothesis_have_no_share(self) -> None:
        evidence = make_evidence(
            make_record(hypotheses=CELLS), make_samples(200, num_hypotheses=10), method="plain"
        )
        demonstrations = [make_demonstration(k, f"d{n}") for n, k in enumerate([0, 2, 2])]
        result = infer(evidence, demonstrations, score="average", clearance=0.5)
        alone = result.is_counted[0] & ~result.is_counted[2]
        assert alone.any()
        assert not alone.all()
        violation = evidence.violation_probability[0, alone]
        np.testing.assert_allclose(result.average_violation[alone], violation)
        error = np.sqrt(violation * (1.0 - violation) / 200)
        np.testing.assert_allclose(result.score_error[alone], error, atol=1e-12)

    def test_can_rank_otherwise_than_the_likelihood(self) -> None:
        """Once nearly always: few nats by the average, many by the likelihood."""
        columns = np.zeros((2, 1000, 10), bool)
        columns[0, :990, 3] = True  # 0.99 and 0
        columns[:, :600, 7] = True  # 0.6 and 0.6
        evidence = evidence_of_columns(columns, CELLS)
        demonstrations = [make_demonstration(0, "a"), make_demonstration(1, "b")]
        assert infer(evidence, demonstrations).ranking[0] == 3
        result = infer(evidence, demonstrations, score="average")
        assert result.ranking[0] == 7
        assert result.to_json()["score"] == "average"

    def test_an_unknown_score_is_refused(self) -> None:
        with pytest.raises(ValueError, match="score: expected one of likelihood, average, got 'm"):
            infer(evidence_with_chances(RISING), score="mean")
