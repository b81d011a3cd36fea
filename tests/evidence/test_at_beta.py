"""Evidence at another beta than the one sampled at."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.carts import CART, GRID, cooled, sampled
from support.evidence_parts import assert_equal
from support.guesses import Guessed
from support.reference import Exact, enumerate_exactly
from support.routes import TASK, LatticeRoutes, routes
from support.short_problems import PROBLEMS
from support.synthetic import make_evidence, make_record, make_samples

from swerve import Evidence, infer, learn, sample
from swerve.evidence import estimators
from swerve.hypotheses.bits import unpack


class TestAtBeta:
    """Of evidence at beta 0.5; the class below holds it against enumeration."""

    @pytest.mark.parametrize("method", ["importance", "plain", "smc"])
    def test_is_the_same_by_whatever_way(self, method: str, tmp_path: Path) -> None:
        samples = make_samples()
        samples = samples._replace(
            log_correction=np.sin(samples.total_reward)
            if method == "smc"
            else samples.length * 0.0,
            soft_value=np.full(3, -1.5),
        )
        evidence = make_evidence(make_record(), samples, method=method)
        there = evidence.at_beta(0.8)
        assert_equal(evidence.at_beta(2.0).at_beta(0.8), there)
        assert there.problem.fingerprint == make_record(beta=0.8).fingerprint
        assert there.sampling_beta == there.at_beta(0.1).sampling_beta == 0.5
        assert np.isnan(there.soft_value).all()
        np.testing.assert_array_equal(evidence.soft_value, -1.5)
        back = there.at_beta(0.5)
        np.testing.assert_array_equal(back.soft_value, -1.5)
        np.testing.assert_array_equal(back.log_ratio, evidence.log_ratio)
        there.save(tmp_path / "a.evidence")
        loaded = Evidence.load(tmp_path / "a.evidence")
        assert_equal(loaded, there)
        assert loaded.at_beta(1).problem.fingerprint == make_record(beta=1.0).fingerprint
        assert_equal(loaded.at_beta(1), evidence.at_beta(1.0))
        assert_equal(evidence.select([2, 0]).at_beta(0.8), there.select([2, 0]))

    @pytest.mark.parametrize("beta", [0.3, 1.5])
    def test_weights_gain_what_theorem_2_says(self, beta: float) -> None:
        samples = make_samples()
        samples.total_reward[:, ::5] = -np.inf
        gained = np.where(np.isfinite(samples.total_reward), (beta - 0.5) * samples.total_reward, 0)
        importance = make_evidence(samples=samples)
        plain = importance.weighted("plain")
        np.testing.assert_allclose(
            importance.at_beta(beta).log_weight, importance.log_weight + gained, rtol=1e-12
        )
        there = plain.at_beta(beta)
        np.testing.assert_allclose(there.log_weight, plain.log_weight + gained, rtol=1e-12)
        assert_equal(there.weighted("importance"), importance.at_beta(beta))
        for k in range(3):
            weight = np.exp(there.log_weight[k])
            avoids = ~unpack(samples.violations[k], 12)
            expected = 1.0 - weight @ avoids / weight.sum()
            np.testing.assert_allclose(there.violation_probability[k], expected, atol=1e-12)
            sizes = [
                estimators.effective_sample_size(source.log_weight[k])
                for source in (there, importance.at_beta(beta))
            ]
            assert there.effective_sample_size[k] == pytest.approx(min(sizes))
        np.testing.assert_allclose(there.resolution, 1.0 / there.effective_sample_size)
        np.testing.assert_array_equal(plain.resolution, 1.0 / 400)

    def test_kl_is_from_the_policy_to_the_new_beta_and_for_plain_to_the_old(self) -> None:
        importance, plain = (make_evidence(method=method) for method in ("importance", "plain"))
        there = importance.at_beta(0.9)
        expected = there.log_partition - there.importance_log_weight.mean(axis=1)
        np.testing.assert_allclose(there.kl, expected, rtol=1e-10)
        np.testing.assert_allclose(plain.at_beta(0.9).kl, plain.kl, rtol=1e-10)
        np.testing.assert_array_equal(plain.at_beta(0.9).log_partition, there.log_partition)

    def test_hoeffding_is_not_for_another_beta(self) -> None:
        message = r"by 'plain' at beta 0\.5, not 0\.9: use standard_error"
        with pytest.raises(ValueError, match=message):
            make_evidence(method="plain").at_beta(0.9).hoeffding_error()

    @pytest.mark.parametrize("beta", [0.0, -1.0, math.nan, math.inf, "2", None, True])
    def test_what_is_no_beta_is_refused(self, beta: Any) -> None:
        with pytest.raises(ValueError, match=f"beta: expected a finite number > 0, got {beta!r}"):
            make_evidence().at_beta(beta)

    def test_samples_are_those_that_were_weighed(self, tmp_path: Path) -> None:
        path = tmp_path / "a.evidence"
        make_evidence().save(path)
        there = Evidence.load(path).at_beta(0.8)
        path.unlink()
        assert_equal(there, make_evidence().at_beta(0.8))


STANDARD_ERRORS = 4.0
OF_ISLANDS = 5.1  # as unlikely, of Student's t with 19 degrees of freedom, as 4 of a normal


@cache
def exact(name: str, beta: float) -> Exact:
    problem, task = PROBLEMS[name]
    return enumerate_exactly(cooled(problem, beta), *task)


def assert_within_errors(evidence: Evidence, truth: Exact, before: Exact) -> None:
    """The answer is that of the new beta, and not that of the old one."""
    most = OF_ISLANDS if evidence.method == "smc" else STANDARD_ERRORS
    error = np.sqrt(evidence.summary.avoid_variance[0]) + 1.0 / evidence.effective_sample_size[0]
    found = evidence.violation_probability[0]
    off, moved = (np.abs(found - x.violation_probability) / error for x in (truth, before))
    is_open = (truth.violation_probability > 0.02) & (truth.violation_probability < 0.98)
    assert np.count_nonzero(is_open) >= 3
    assert off[is_open].max() < most
    assert moved[is_open].max() > 1.5 * most
    np.testing.assert_allclose(found, truth.violation_probability, atol=0.05)
    islands = evidence.island_log_partition[0]
    spread = islands.std() / math.sqrt(len(islands) - 1)
    assert spread < 0.1
    assert evidence.log_partition[0] == pytest.approx(
        truth.log_partition, abs=OF_ISLANDS * spread + 1e-3
    )


class TestEvidenceAtAnotherBeta:
    @pytest.mark.parametrize(
        ("method", "factor"),
        [("importance", 0.75), ("importance", 2.0), ("plain", 0.75), ("plain", 2.0), ("smc", 3.0)],
    )
    @pytest.mark.parametrize("name", PROBLEMS)
    def test_agrees_with_enumeration(self, name: str, method: str, factor: float) -> None:
        problem, task = PROBLEMS[name]
        source = learn(problem, GRID)
        if method == "smc":  # by a bad value, such that there is something to resample
            source = Guessed(problem, -0.4 if name == "pendulum" else 0.1)
        evidence = sample(source, task, 20_000, method=method)
        assert method != "smc" or evidence.distinct_share[0] < 0.9
        beta = factor * problem.beta
        assert_within_errors(evidence.at_beta(beta), exact(name, beta), exact(name, problem.beta))

    def test_is_evidence_of_the_problem_at_that_beta(self) -> None:
        evidence = sampled().at_beta(np.float32(3))  # pyright: ignore[reportArgumentType]
        assert evidence.problem.fingerprint == cooled(CART, 3.0).record.fingerprint
        assert evidence.sampling_beta == 2.0
        assert "beta 3" in infer(evidence).evidence.problem.summary

    def test_exact_answers_are_refused(self) -> None:
        evidence = sample(learn(routes(LatticeRoutes(toll=1.0))), TASK)
        with pytest.raises(ValueError, match=r"for their beta, 1, alone .* again at beta 0\.5"):
            evidence.at_beta(0.5)
