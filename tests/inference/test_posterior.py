"""The posterior: priors, credible sets, and errors that hold over repeated sampling."""

from __future__ import annotations

import json
import math
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.synthetic import (
    evidence_of_columns,
    make_demonstration,
    make_evidence,
    make_record,
    make_samples,
)

from swerve import Box, Problem, learn, sample, tabular
from swerve.answer import infer
from swerve.base.space import TWO_PI, Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.hypotheses.grid import grid
from swerve.inference.posterior import (
    Posterior,
    checked_prior,
    credible_set,
    jackknife_error,
    log_bayes_factor,
    posterior,
)

CELLS = grid(x=(0.0, 9.0, 4))
CHANCES = np.array([0.05, 0.3, 0.6, 0.9])

seeds = st.integers(0, 2**31 - 1)


def sampled(seed: int, num: int = 2_000):
    """Evidence of three tasks whose four cells are entered together or not at all, as it were."""
    generator = np.random.default_rng(seed)
    draws = generator.random((3, num, 1))
    return evidence_of_columns(draws < CHANCES, CELLS)


class TestPosterior:
    @given(seed=seeds)
    @settings(max_examples=50)
    def test_is_bayes_rule(self, seed: int) -> None:
        generator = np.random.default_rng(seed)
        log_likelihood = generator.normal(0.0, 5.0, 6)
        prior = generator.dirichlet(np.ones(7))
        joint = prior * np.concatenate([[1.0], np.exp(log_likelihood)])
        np.testing.assert_allclose(posterior(log_likelihood, prior), joint / joint.sum())

    def test_large_numbers_do_not_overflow(self) -> None:
        found = posterior(np.array([2000.0, 1999.0, -np.inf]), checked_prior(None, 3))
        np.testing.assert_allclose(found, [0.0, 1 / (1 + math.exp(-1)), 1 / (1 + math.e), 0.0])

    def test_none_is_as_probable_as_all_hypotheses_before_anything_is_seen(self) -> None:
        np.testing.assert_allclose(posterior(np.zeros(8), checked_prior(None, 8))[0], 0.5)

    def test_bayes_factor_is_the_mean_likelihood_ratio(self) -> None:
        log_likelihood = np.log([2.0, 6.0, 1.0])
        assert log_bayes_factor(log_likelihood, checked_prior(0.9, 3)) == pytest.approx(
            math.log(3.0)
        )
        ruled_out = np.full(3, -np.inf)
        assert log_bayes_factor(ruled_out, checked_prior(None, 3)) == -math.inf
        given = np.array([0.2, 0.2, 0.6, 0.0])
        expected = math.log(0.25 * 2.0 + 0.75 * 6.0)
        assert log_bayes_factor(log_likelihood, given) == pytest.approx(expected)

    def test_nothing_that_the_prior_allows_is_left(self) -> None:
        with pytest.raises(ValueError, match="rule out every hypothesis, and P\\(no constraint\\)"):
            posterior(np.full(3, -np.inf), checked_prior(0.0, 3))


class TestPrior:
    def test_shares_alike(self) -> None:
        np.testing.assert_allclose(checked_prior(None, 4), [0.5, *[0.125] * 4])
        np.testing.assert_allclose(checked_prior(0.2, 4), [0.2, *[0.2] * 4])

    @pytest.mark.parametrize(
        ("prior", "message"),
        [
            (1.5, "expected P\\(no constraint\\) from 0 to 1, got 1.5"),
            (np.ones(3) / 3, "expected 5 probabilities, that of no constraint first"),
            (np.array([0.5, 0.5, 0.5, -0.5, 0.0]), "expected probabilities >= 0, got -0.5 at 3"),
            (np.array([0.5, np.nan, 0.5, 0.0, 0.0]), "expected probabilities >= 0, got nan at 1"),
            ("a", r"expected P\(no constraint\), or 5 probabilities, that of no .* first, got 'a'"),
            (True, r"expected P\(no constraint\), or 5 probabilities"),
            ({"none": 0.5}, r"expected P\(no constraint\), or 5 probabilities"),
            (
                np.full(5, 0.3),
                "expected probabilities that sum to 1, got a sum of 1.5: divide each by the sum",
            ),
        ],
    )
    def test_bad_ones_are_refused(self, prior, message: str) -> None:
        with pytest.raises(ValueError, match=f"prior: {message}"):
            checked_prior(prior, 4)


class TestCredibleSet:
    FOUND = Posterior(0.3, 0.0, np.array([0.05, 0.6, 0.04, 0.01]), np.zeros(4))

    def test_is_the_smallest(self) -> None:
        found = credible_set(self.FOUND, 0.8)
        assert found.has_none
        np.testing.assert_array_equal(found.hypotheses, [1])
        assert found.probability == pytest.approx(0.9)
        assert not credible_set(self.FOUND, 0.6).has_none
        np.testing.assert_array_equal(credible_set(self.FOUND, 0.99).hypotheses, [1, 0, 2])

    def test_of_certainty(self) -> None:
        certain = Posterior(1.0, 0.0, np.zeros(4), np.zeros(4))
        assert credible_set(certain, 0.999999) == (True, pytest.approx([]), 1.0)

    @pytest.mark.parametrize("least", [0.0, 1.0, -1.0, math.nan, "a", None])
    def test_bad_probability(self, least: Any) -> None:
        with pytest.raises(ValueError, match="expected a probability between 0 and 1, got"):
            credible_set(self.FOUND, least)


class TestOfInference:
    def test_follows_the_demonstrations(self) -> None:
        evidence = sampled(0)
        demonstrations = [make_demonstration(k, f"d{k}") for k in (0, 1)]
        result = infer(evidence, demonstrations, prior=0.25)
        joint = np.concatenate([[0.25], 0.75 / 4 * np.exp(result.log_likelihood)])
        expected = joint / joint.sum()
        assert result.posterior.none == pytest.approx(expected[0])
        np.testing.assert_allclose(result.posterior.hypotheses, expected[1:])

    def test_errors_are_the_spread_over_repeated_samples(self) -> None:
        """Cells are entered together, so that errors of one are those of another."""
        demonstrations = [make_demonstration(k, f"d{k}") for k in (0, 2, 2)]
        found = [infer(sampled(seed), demonstrations).posterior for seed in range(200)]
        for field, error in (("none", "none_error"), ("hypotheses", "error")):
            spread = np.std([getattr(one, field) for one in found], axis=0)
            stated = np.sqrt(np.mean([getattr(one, error) ** 2 for one in found], axis=0))
            np.testing.assert_allclose(stated, spread, rtol=0.25)

    def test_errors_of_importance_weights_too(self) -> None:
        def drawn(seed: int):
            generator = np.random.default_rng(seed)
            evidence = sampled(seed)
            reward = generator.normal(0.0, 2.0, (3, 2_000))
            samples = evidence.samples._replace(total_reward=reward)
            return make_evidence(evidence.problem, samples, evidence.tasks, "importance")

        demonstrations = [make_demonstration(k, f"d{k}") for k in (0, 2)]
        found = [infer(drawn(seed), demonstrations).posterior for seed in range(200)]
        spread = np.std([one.none for one in found])
        stated = np.sqrt(np.mean([one.none_error**2 for one in found]))
        assert stated == pytest.approx(spread, rel=0.25)

    def test_a_ratio_worked_out_has_its_own_error(self) -> None:
        """By the delta method: d p_j / d log L_h = p_j (1[j = h] - p_h)."""
        evidence = sampled(0)
        shape = evidence.summary.log_ratio.shape
        log_ratio = np.broadcast_to(np.log([0.5, 0.25, 0.125, 0.0625]), shape)
        error = np.broadcast_to([0.0, 0.0, 0.0, 0.02], shape)
        summary = evidence.summary._replace(log_ratio=log_ratio, log_ratio_error=error)
        known = make_evidence(
            evidence.problem, evidence.samples, evidence.tasks, "plain", summary=summary
        )
        # twice task 1: log L = 2 log 2, 2 log 4, ...; the error doubles
        result = infer(known, [make_demonstration(1, "a"), make_demonstration(1, "b")])
        value = np.concatenate([[result.posterior.none], result.posterior.hypotheses])
        step = 1e-6
        log_likelihood = result.log_likelihood + np.array([0.0, 0.0, 0.0, step])
        slope = (posterior(log_likelihood, result.prior) - value) / step
        stated = np.concatenate([[result.posterior.none_error], result.posterior.error])
        np.testing.assert_allclose(stated, 0.04 * np.abs(slope), rtol=1e-4)

    def test_no_demonstration_enters_anything_and_none_remains_possible(self) -> None:
        result = infer(sampled(0), [make_demonstration(0)])
        assert 0.0 < result.posterior.none < 0.5

    def test_without_demonstrations_it_is_the_prior(self) -> None:
        result = infer(sampled(0), prior=[0.2, 0.5, 0.0, 0.2, 0.1])
        assert result.posterior.none == pytest.approx(0.2)
        assert result.posterior.none_error == 0.0
        np.testing.assert_array_equal(result.posterior.hypotheses, result.prior[1:])
        np.testing.assert_array_equal(result.posterior.error, 0.0)
        assert result.log_bayes_factor == 0.0

    @pytest.mark.parametrize("prior", [0.0, [0.0, 0.0, 1.0], [0.0, 0.7, 0.3]])
    def test_without_demonstrations_nothing_is_ruled_out(self, prior: Any) -> None:
        """Nobody can avoid where the only trajectory leads, and nobody has been seen there."""
        leads = tabular([[1], [1]], [[0.0], [0.0]], num_steps=1)
        problem = Problem(leads, [Box(state=(0.5, 9.0)), Box(state=(-0.5, 9.0))])
        result = infer(sample(learn(problem, "enumeration"), [Task([0.0], [])]), prior=prior)
        assert result.struck_out.all()
        assert not result.is_ruled_out
        np.testing.assert_array_equal(result.posterior.hypotheses, result.prior[1:])
        assert "none of these" not in result.belief
        stated = json.loads(json.dumps(result.to_json()))
        assert stated["none"]["posterior"] == 0.0
        assert str(result)

    @pytest.mark.filterwarnings("error")
    def test_a_prior_of_certainty(self) -> None:
        demonstrations = [make_demonstration(0, "a", x=3.0), make_demonstration(0, "b", x=7.0)]
        certain = infer(sampled(0), demonstrations, prior=1.0)
        assert certain.posterior.none == 1.0
        assert certain.posterior.none_error == 0.0
        assert certain.log_bayes_factor == -math.inf
        assert certain.least_tolerance is None
        struck = int(np.flatnonzero(certain.struck_out)[0])
        prior = np.zeros(5)
        prior[1 + struck] = 1.0
        nothing = infer(sampled(0), demonstrations, prior=prior)
        assert nothing.is_ruled_out
        assert not certain.is_ruled_out
        with pytest.raises(ValueError, match="rule out every hypothesis"):
            _ = nothing.posterior
        assert nothing.belief.startswith("Posterior: none of these 4: no constraint at all, or")
        data = json.loads(json.dumps(nothing.to_json()))
        assert data["none"]["posterior"] is None
        assert data["credible_set"] is None
        assert data["ranking"][0]["posterior"] is None

    def test_one_island_that_holds_all_who_avoid(self) -> None:
        """Leaving it out leaves less than one trajectory's share, not certainty either way."""
        columns = np.ones((1, 2_000, 2), bool)
        columns[0, :100] = False  # of 20 islands, the first
        evidence = evidence_of_columns(columns, grid(x=(0.0, 9.0, 2)))
        without = evidence.summary.avoid_without_island[0]
        assert (without == 0.0).any()
        assert (without > 0.05).any()
        result = infer(evidence, [make_demonstration(0)])
        assert result.struck_out.tolist() == [True, False]
        # L = 19 without any of the others and 2,000 without that one; P(none) = 1 / (1 + L / 2)
        with_it, without_it = (1.0 / (1.0 + 0.5 * ratio) for ratio in (19.0, 2000.0))
        stated = 19.0 / 20.0 * (with_it - without_it)
        assert result.posterior.none_error == pytest.approx(stated, rel=1e-4)

    def test_takes_less_memory_than_twice_the_values_without_an_island(self) -> None:
        tasks = Task(np.c_[np.zeros(20), np.linspace(1.0, 9.0, 20)], np.ones((20, 2)))
        cells = grid(theta=(0.0, TWO_PI, 20), x=(0.0, 9.0, 25))
        samples = make_samples(100, tasks, 500)
        evidence = make_evidence(make_record(hypotheses=cells), samples, tasks)
        found = [
            Demonstration(f"d{x[1]}", np.array([x, x + 0.1]), Task(x, y))
            for x, y in zip(*tasks, strict=True)
        ]
        result = infer(evidence, found, tolerance=0.1)
        assert np.isfinite(result.standard_error).all()  # is kept, as is all that it needs
        tracemalloc.start()
        try:
            assert result.posterior.none_error > 0.0
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert peak < 2 * evidence.summary.avoid_without_island.nbytes

    def test_demonstrations_are_added_one_by_one(self) -> None:
        evidence = sampled(0)
        demonstrations = [
            make_demonstration(k, f"d{k}", x=x) for k, x in ((0, 0.5), (1, None), (2, 5.0))
        ]
        together, one_by_one = (
            infer(evidence, demonstrations, tolerance=0.1),
            infer(evidence, tolerance=0.1),
        )
        for demonstration in demonstrations:
            one_by_one = one_by_one.add(demonstration)
        np.testing.assert_allclose(one_by_one.log_likelihood, together.log_likelihood)
        np.testing.assert_array_equal(one_by_one.entered, together.entered)
        assert one_by_one.posterior.none == pytest.approx(together.posterior.none)
        assert one_by_one.add() is one_by_one


def test_jackknife_error_of_a_mean_is_that_of_the_mean() -> None:
    values = np.random.default_rng(0).normal(size=20)
    without = (values.sum() - values) / 19
    assert jackknife_error(without) == pytest.approx(values.std(ddof=1) / math.sqrt(20))
