"""Beta fitted to demonstrations."""

from __future__ import annotations

import json
import math
from functools import cache

import numpy as np
import pytest
from support.carts import CART, OTHER_TASK, cooled, sampled, shown
from support.guesses import Guessed
from support.reference import CART_TASK, enumerate_exactly, short_cart
from support.routes import TASK, LatticeRoutes, Routes, routes

from swerve import BetaFit, Demonstration, Task, fit_beta, infer, learn, sample
from swerve.fitting.beta import Likelihood
from swerve.fitting.rewards import total_rewards

STANDARD_ERRORS = 4.0


@cache
def of_two_tasks() -> Likelihood:
    """Log L of three demonstrations of one task and five of another."""
    evidence = sampled(num=20_000, seed=1)
    made = [*shown()[:3], *shown(num=5, task=1)]
    task_of = infer(evidence, made).task_of
    np.testing.assert_array_equal(task_of, [0, 0, 0, 1, 1, 1, 1, 1])
    return Likelihood.of(evidence, task_of, total_rewards(CART, made))


class TestLikelihood:
    @pytest.fixture
    def likelihood(self) -> Likelihood:
        return of_two_tasks()

    @pytest.mark.parametrize("beta", [1.0, 2.0, 3.5])
    def test_score_is_the_derivative_of_what_enumeration_says(
        self, likelihood: Likelihood, beta: float
    ) -> None:
        def log_likelihood(beta: float) -> float:
            problem = cooled(CART, beta)
            parts = [enumerate_exactly(problem, *task) for task in (CART_TASK, OTHER_TASK)]
            return beta * likelihood.earned - sum(
                num * part.log_partition for num, part in zip((3, 5), parts, strict=True)
            )

        step = 0.02
        below, here, above = (log_likelihood(beta + step * k) for k in (-1, 0, 1))
        point = likelihood.at(beta)
        assert point.score_error < 0.2
        assert point.score == pytest.approx(
            (above - below) / (2 * step), abs=STANDARD_ERRORS * point.score_error
        )
        assert point.value == pytest.approx(here, abs=0.1)
        assert point.curvature == pytest.approx((2 * here - above - below) / step**2, rel=0.1)

    def test_is_concave_and_its_parts_agree(self, likelihood: Likelihood) -> None:
        betas = np.linspace(0.0, 8.0, 81)
        points = [likelihood.at(beta) for beta in betas]
        value, score = (np.array([getattr(p, name) for p in points]) for name in ("value", "score"))
        assert (np.diff(score) < 0.0).all()
        np.testing.assert_allclose(np.gradient(value, betas)[1:-1], score[1:-1], atol=0.05)
        curvature = [point.curvature for point in points[1:-1]]
        np.testing.assert_allclose(-np.gradient(score, betas)[1:-1], curvature, rtol=0.02)

    def test_is_the_same_whatever_beta_the_evidence_is_weighed_for(
        self, likelihood: Likelihood
    ) -> None:
        evidence = sampled(num=20_000, seed=1).at_beta(5.0)
        task_of = np.repeat([0, 1], [3, 5])
        other = Likelihood.of(evidence, task_of, np.array([likelihood.earned] + [0.0] * 7))
        a, b = likelihood.at(1.2), other.at(1.2)
        assert b.score == pytest.approx(a.score, rel=1e-9)
        assert b.value == pytest.approx(a.value, rel=1e-9)
        np.testing.assert_allclose(b.effective_sample_size, a.effective_sample_size)

    def test_effective_samples_are_those_of_evidence(self, likelihood: Likelihood) -> None:
        for evidence in (
            sampled(num=20_000, seed=1),
            sample(Guessed(CART, 0.1), [CART_TASK, OTHER_TASK], 2_000, method="smc"),
        ):
            found = Likelihood.of(evidence, np.array([0, 1]), np.zeros(2)).at(3.0)
            np.testing.assert_allclose(
                found.effective_sample_size, evidence.at_beta(3.0).effective_sample_size
            )


class TestFit:
    def test_intervals_cover_the_beta_of_the_demonstrators(self) -> None:
        """Of 20 intervals at 80 %, each from 12 demonstrations, between 12 and 19 hold it."""
        made, evidence = shown(), sampled(1.2)
        fits = [fit_beta(CART, evidence, made[12 * k : 12 * k + 12], 0.8) for k in range(20)]
        covers = [fit.interval[0] < 2.0 < fit.interval[1] for fit in fits]
        assert 12 <= sum(covers) <= 19
        width = np.median([fit.interval[1] - fit.interval[0] for fit in fits])
        curvature = Likelihood.of(evidence, np.zeros(12, int), np.zeros(12)).at(2.0).curvature
        assert width == pytest.approx(2 * 1.2816 / math.sqrt(curvature), rel=0.25)

    @pytest.mark.parametrize(("beta", "sampling"), [(1.0, 0.7), (2.0, 2.0), (4.0, 2.0)])
    def test_all_together_give_the_beta_of_the_demonstrators(
        self, beta: float, sampling: float
    ) -> None:
        """Also where samples and problem have another."""
        fit = fit_beta(cooled(CART, 7.0), sampled(sampling), shown(beta, 80), 0.999)
        low, high = fit.interval
        assert low < beta < high
        assert low < fit.beta < high
        assert high - low < 1.5 * beta
        assert fit.trusted[0] < low
        assert high < fit.trusted[1]
        assert not fit.at_boundary

    def test_likelihood_falls_by_the_same_at_both_ends(self) -> None:
        made, evidence = shown()[:20], sampled()
        fit = fit_beta(CART, evidence, made)
        likelihood = Likelihood.of(evidence, np.zeros(20, int), total_rewards(CART, made))
        best = likelihood.at(fit.beta).value
        for end in fit.interval:
            assert best - likelihood.at(end).value == pytest.approx(3.8415 / 2, abs=1e-3)

    def test_standard_error_is_the_spread_of_samplings(self) -> None:
        fits = [fit_beta(CART, sampled(num=1_000, seed=seed), shown()[:20]) for seed in range(30)]
        stated = np.sqrt(np.mean([fit.standard_error**2 for fit in fits]))
        assert np.std([fit.beta for fit in fits]) == pytest.approx(stated, rel=0.4)

    def test_resampled_trajectories_do_as_well(self) -> None:
        evidence = sample(Guessed(CART, 0.1), CART_TASK, 4_000, method="smc")
        smc, importance = (fit_beta(CART, source, shown()) for source in (evidence, sampled()))
        error = math.hypot(smc.standard_error, importance.standard_error)
        assert error < 0.2
        assert smc.beta == pytest.approx(importance.beta, abs=STANDARD_ERRORS * error)

    def test_who_beats_every_sample_is_at_the_boundary(self) -> None:
        straight = np.linspace(CART_TASK.start, CART_TASK.goal, 8)
        made = Demonstration("ideal", straight, CART_TASK, actions=np.zeros((7, 1)))
        fit = fit_beta(CART, sampled(), [made])
        assert fit.at_boundary
        assert fit.beta == fit.interval[1] == math.inf
        assert 0.0 < fit.interval[0] < fit.trusted[1]
        assert math.isnan(fit.standard_error)
        assert str(fit).startswith(f"beta at the boundary: at least {fit.interval[0]:.3g}, as ")
        written = json.loads(json.dumps(fit.to_json(), allow_nan=False))
        assert written["beta"] is written["high"] is written["standard_error"] is None
        assert written["at_boundary"] is True
        assert not fit_beta(CART, sampled(), [made, *shown()[:20]]).at_boundary

    def test_who_earns_as_much_as_the_best_sample_is_at_the_boundary(self) -> None:
        """Rewards of demonstrations and samples differ by rounding; many share the best one."""
        problem = routes(Routes(), known=[], beta=4.0)
        straight = Demonstration("straight", np.linspace(*TASK, 9), TASK, actions=np.zeros((8, 1)))
        evidence = sample(learn(problem, "grid?num_points=40"), TASK, 2_000)
        assert total_rewards(problem, [straight])[0] == evidence.samples.total_reward.max()
        assert fit_beta(problem, evidence, [straight]).beta == math.inf

    @pytest.mark.parametrize(("earned", "is_best"), [(0.0, True), (-1e-6, True), (-0.1, False)])
    def test_rounding_of_rewards_does_not_count(self, earned: float, is_best: bool) -> None:
        """Where the best earn nothing, what rounding is goes by what others earn."""
        reward, none = -np.arange(4.0)[None], np.zeros((1, 4))
        likelihood = Likelihood(5 * earned, np.array([5]), reward, none, np.arange(4)[None])
        assert likelihood.earns_most == is_best

    def test_a_finite_beta_that_is_out_of_reach_is_asked_to_be_sampled(self) -> None:
        """Rewards of many steps: nothing sampled at beta 1 earns what those of beta 5 do."""
        generator = np.random.default_rng(0)
        reward = -generator.gamma(30.0, 1.0, (1, 10_000))
        earned = float(-generator.gamma(30.0, 1.0 / 5.0, 20).sum())
        ancestor = np.arange(10_000)[None]
        likelihood = Likelihood(earned, np.array([20]), reward, -reward, ancestor)
        assert likelihood.earns_most
        fit = BetaFit(math.inf, (1.5, math.inf), math.nan, (0.5, 1.9), 0.95)
        assert "sample at beta 1.9 and fit again" in str(fit)

    def test_who_earns_less_than_at_random_is_at_zero(self) -> None:
        worst = min(shown(0.3, 40), key=lambda made: total_rewards(CART, [made])[0])
        fit = fit_beta(CART, sampled(0.1), [worst] * 5)
        assert fit.at_boundary
        assert fit.beta == fit.interval[0] == fit.trusted[0] == 0.0
        assert 0.0 < fit.interval[1] < 0.1
        assert str(fit).startswith("beta at the boundary: 0 to 0.")

    def test_an_end_that_no_sample_tells_is_open(self) -> None:
        made = shown()[:60]
        good = np.argsort(total_rewards(CART, made))[40]
        fit = fit_beta(CART, sampled(num=400), [made[good]])
        assert fit.interval[1] == math.inf
        assert " or more, standard error" in str(fit)

    def test_a_maximum_beyond_the_samples_names_the_beta_to_sample_at(self) -> None:
        for sampling, beta, where in ((0.05, 8.0, "above"), (8.0, 0.3, "below")):
            evidence = sampled(sampling, 4_000)
            with pytest.raises(
                ValueError, match=f"greatest {where} beta .* not to be trusted"
            ) as caught:
                fit_beta(CART, evidence, shown(beta, 40))
            edge = float(str(caught.value).partition(f"{where} beta ")[2].partition(",")[0])
            assert f"swerve.sample(nominal, tasks, beta={edge:.3g})" in str(caught.value)
            assert evidence.at_beta(edge).effective_sample_size[0] > 99.0
            if where == "below":
                assert edge == 0.5 * sampling
            else:
                assert evidence.at_beta(1.3 * edge).effective_sample_size[0] < 100.0


class TestBadArguments:
    @pytest.mark.parametrize("confidence", [0.0, 1.0, -1.0, math.nan])
    def test_confidence(self, confidence: float) -> None:
        with pytest.raises(ValueError, match="confidence: expected a number between 0 and 1, got"):
            fit_beta(CART, sampled(), shown(), confidence)

    def test_demonstrations(self) -> None:
        for made in ([], shown()[0]):
            with pytest.raises(ValueError, match="demonstrations: expected a list of at least one"):
                fit_beta(CART, sampled(), made)  # pyright: ignore[reportArgumentType]
        nothing = Task(np.zeros(2), np.zeros(2))
        made = Demonstration("elsewhere", np.zeros((3, 2)), nothing, actions=np.ones((2, 1)))
        with pytest.raises(ValueError, match="elsewhere: no evidence for start"):
            fit_beta(CART, sampled(), [made])

    def test_problem(self) -> None:
        with pytest.raises(ValueError, match=r"problem: expected a swerve\.Problem, got Prob"):
            fit_beta(CART.record, sampled(), shown())  # pyright: ignore[reportArgumentType]
        with pytest.raises(
            ValueError, match="evidence: expected evidence of the problem, whose beta"
        ):
            fit_beta(short_cart(measure="counting"), sampled(), shown())

    def test_evidence(self) -> None:
        with pytest.raises(ValueError, match=r"evidence: expected a swerve\.Evidence"):
            fit_beta(CART, None, shown())  # pyright: ignore[reportArgumentType]
        lattice = routes(LatticeRoutes())
        answers = sample(learn(lattice), TASK)
        straight = Demonstration("straight", np.linspace(*TASK, 9), TASK)
        with pytest.raises(ValueError, match=r"evidence: exact answers by Tabular.* no samples"):
            fit_beta(lattice, answers, [straight])
        with pytest.raises(ValueError, match=r"at least 100 in every task at beta 2, .* got [78]"):
            fit_beta(CART, sampled(num=80), shown())


def test_a_fit_is_said_as_people_say_it() -> None:
    fit = BetaFit(0.7123, (0.5811, 0.8642), 0.01, (0.1, 3.0), 0.95)
    assert (
        str(fit)
        == "beta 0.712, 95 % interval 0.581 to 0.864, standard error from sampling alone 0.01"
    )
    assert fit.to_json()["high"] == 0.8642
