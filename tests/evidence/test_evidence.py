from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.synthetic import (
    SPACE,
    TASKS,
    evidence_of_columns,
    make_evidence,
    make_record,
    make_samples,
)

from swerve.base.space import TWO_PI, StateSpace, Task
from swerve.base.store import StoreError, open_file
from swerve.constraints.boxes import Box
from swerve.evidence import estimators
from swerve.evidence.evidence import KIND, MATCH_TOLERANCE, VERSION, Evidence
from swerve.evidence.samples import summarise
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.bits import unpack
from swerve.hypotheses.grid import grid

PARTS = ("tasks", "summary", "samples")
PROPERTIES = (
    "violation_probability",
    "log_ratio",
    "standard_error",
    "log_partition",
    "kl",
    "effective_sample_size",
)


def assert_equal(a: Evidence, b: Evidence) -> None:
    assert a.problem.to_json() == b.problem.to_json()
    assert a.problem.fingerprint == b.problem.fingerprint
    for name in ("method", "num_trajectories", "solver", "seed", "sampling_beta"):
        assert getattr(a, name) == getattr(b, name)
    for part in PARTS:
        for x, y in zip(getattr(a, part), getattr(b, part), strict=True):
            np.testing.assert_array_equal(x, y, strict=True)


def damage(path: Path, array: np.ndarray) -> None:
    """Flip one bit of an array inside a file."""
    content = bytearray(path.read_bytes())
    at = bytes(content).find(array.tobytes())
    assert at > 0
    content[at] ^= 1
    path.write_bytes(content)


class TestSummary:
    @pytest.mark.parametrize("measure", ["uniform", "counting"])
    def test_each_task_is_estimated_from_its_own_samples(self, measure: str) -> None:
        record, samples = make_record(measure=measure), make_samples()
        evidence = make_evidence(record, samples)
        log_weight = 0.5 * samples.total_reward - samples.log_probability
        if measure == "uniform":
            log_weight = log_weight - samples.length * math.log(3)
        np.testing.assert_allclose(evidence.importance_log_weight, log_weight, rtol=1e-13)
        np.testing.assert_allclose(evidence.log_weight, log_weight, rtol=1e-13)
        for k in range(3):
            weight = np.exp(log_weight[k])
            avoids = ~unpack(samples.violations[k], 12)
            log_z = math.log(weight.mean())
            ess = weight.sum() ** 2 / (weight**2).sum()
            np.testing.assert_allclose(
                evidence.violation_probability[k], 1.0 - weight @ avoids / weight.sum(), atol=1e-12
            )
            assert evidence.log_partition[k] == pytest.approx(log_z)
            assert evidence.kl[k] == pytest.approx(log_z - log_weight[k].mean())
            assert evidence.effective_sample_size[k] == pytest.approx(ess)
            assert 100 < ess < 399

    def test_plain_weighs_all_alike_and_still_reports_the_weights(self) -> None:
        samples = make_samples()
        plain, weighted = (
            make_evidence(samples=samples, method=m) for m in ("plain", "importance")
        )
        fraction = unpack(samples.violations, 12).mean(axis=1)
        np.testing.assert_allclose(plain.violation_probability, fraction, atol=1e-12)
        np.testing.assert_array_equal(plain.log_weight, 0.0)
        for name in ("log_partition", "kl", "effective_sample_size", "importance_log_weight"):
            np.testing.assert_array_equal(getattr(plain, name), getattr(weighted, name))
        assert np.abs(plain.violation_probability - weighted.violation_probability).max() > 0.01

    @pytest.mark.parametrize("method", ["plain", "importance"])
    def test_trajectories_in_a_known_constraint_do_not_count(self, method: str) -> None:
        samples = make_samples()
        forbidden = np.arange(400) % 4 == 0
        samples.total_reward[:, forbidden] = -np.inf
        evidence = make_evidence(samples=samples, method=method)
        left = samples._replace(
            total_reward=samples.total_reward[:, ~forbidden],
            log_probability=samples.log_probability[:, ~forbidden],
            length=samples.length[:, ~forbidden],
            log_correction=samples.log_correction[:, ~forbidden],
            ancestor=samples.ancestor[:, : np.count_nonzero(~forbidden)],
            violations=samples.violations[:, ~forbidden],
        )
        alone = make_evidence(samples=left, method=method)
        np.testing.assert_allclose(
            evidence.violation_probability, alone.violation_probability, atol=1e-12
        )
        np.testing.assert_allclose(
            evidence.log_partition, alone.log_partition + math.log(0.75), atol=1e-12
        )
        np.testing.assert_allclose(evidence.kl, alone.kl, atol=1e-12)
        assert np.isneginf(evidence.log_weight[:, forbidden]).all()
        assert np.isfinite(evidence.log_weight[:, ~forbidden]).all()

    def test_nan_is_refused(self) -> None:
        samples = make_samples()
        samples.total_reward[1, 7] = np.nan
        with pytest.raises(ValueError, match="1 of 1200 log-weights are not finite"):
            summarise(make_record(), samples, "importance")

    def test_a_task_that_no_sample_survives_is_refused(self) -> None:
        samples = make_samples()
        samples.total_reward[2] = -np.inf
        with pytest.raises(ValueError, match="all 400 sampled trajectories enter a known"):
            summarise(make_record(), samples, "importance")


class TestFloorAndErrors:
    """128 equal weights: fractions are exact."""

    @pytest.fixture
    def evidence(self) -> Evidence:
        num_avoiding = np.array([0, 1, 2, 64, 127, 128])
        columns = np.arange(128)[:, None] >= num_avoiding
        return evidence_of_columns(columns[None], grid(x=(0.0, 6.0, 6)))

    def test_log_ratio_is_at_least_minus_log_n(self, evidence: Evidence) -> None:
        fractions = np.array([1, 1, 2, 64, 127, 128]) / 128
        np.testing.assert_allclose(evidence.log_ratio[0], np.log(fractions), atol=1e-14)
        np.testing.assert_array_equal(
            evidence.violation_probability[0], 1.0 - np.array([0, 1, 2, 64, 127, 128]) / 128
        )

    def test_floored_where_fewer_than_one_trajectory_avoids(self, evidence: Evidence) -> None:
        np.testing.assert_array_equal(evidence.is_floored[0], [True, *[False] * 5])

    def test_standard_error(self, evidence: Evidence) -> None:
        """1 where floored; sqrt((1 - p) / (p N)) by the delta method; 1 / N at least."""
        p = np.array([1, 2, 64, 127, 128]) / 128
        expected = np.maximum(np.sqrt((1.0 - p) / (128 * p)), 1 / 128)
        assert evidence.standard_error[0, 0] == 1.0
        np.testing.assert_allclose(evidence.standard_error[0, 1:], expected, rtol=1e-12)
        assert evidence.standard_error[0, -1] == 1 / 128

    def test_one_heavy_trajectory_resolves_nothing(self) -> None:
        """The floor rests on the effective sample size: here one of two has all the weight."""
        samples = make_samples(2, num_hypotheses=12)
        samples.total_reward[:] = [0.0, -20.0]
        samples.log_probability[:], samples.length[:] = -1.0, 5
        avoids = np.ones((3, 2, 12), bool)
        avoids[:, 0, 0] = avoids[:, 1, 1] = False  # 0 is avoided by the light one alone
        evidence = make_evidence(
            samples=samples._replace(violations=np.packbits(~avoids, axis=-1, bitorder="little"))
        )
        np.testing.assert_array_equal(evidence.is_floored[:, :3], [[True, False, False]] * 3)
        np.testing.assert_allclose(evidence.log_ratio[:, 0], 0.0, atol=1e-3)
        plain = dataclasses.replace(evidence, method="plain")
        np.testing.assert_allclose(plain.resolution, 0.5)
        np.testing.assert_array_equal(evidence.standard_error[:, 0], 1.0)
        # and no error is less than what one trajectory could change, 1 / ESS
        assert evidence.effective_sample_size == pytest.approx([1.0] * 3, abs=1e-3)
        np.testing.assert_allclose(evidence.standard_error[:, 2], 1.0, atol=1e-3)

    @given(seed=st.integers(0, 2**32 - 1))
    @settings(max_examples=30)
    def test_one_more_constraint_never_raises_the_ratio(self, seed) -> None:
        samples = make_samples(100, seed=seed)
        violates = unpack(samples.violations, 12)
        violates[..., 2] = violates[..., 0] | violates[..., 1]
        packed = np.packbits(violates, axis=-1, bitorder="little")
        ratio = make_evidence(samples=samples._replace(violations=packed)).log_ratio
        assert (ratio[:, 2] <= np.minimum(ratio[:, 0], ratio[:, 1]) + 1e-12).all()
        assert (ratio <= 0.0).all()
        assert (ratio >= -math.log(100)).all()

    def test_hoeffding_is_for_equal_weights_alone(self) -> None:
        plain = make_evidence(method="plain", num_trajectories=10_000)
        assert plain.hoeffding_error() == pytest.approx(0.0136, abs=5e-5)
        assert plain.hoeffding_error(0.99) == estimators.hoeffding_error(10_000, 0.99)
        message = r"needs equal weights \(method 'plain'\), .* by 'importance': use standard_error"
        with pytest.raises(ValueError, match=message):
            make_evidence().hoeffding_error()


class TestFiles:
    def test_round_trip(self, tmp_path: Path) -> None:
        known = (Box(x=(0.1, 0.3), theta=(6.0, 7.0)),)
        record = make_record(known=known, beta=0.67, dt=1 / 60, measure="counting")
        evidence = make_evidence(record, method="plain", solver="PPO(num_steps=7)", seed=2**40)
        evidence.save(tmp_path / "a.evidence")
        loaded = Evidence.load(tmp_path / "a.evidence")
        assert_equal(loaded, evidence)
        for name in PROPERTIES:
            np.testing.assert_array_equal(getattr(loaded, name), getattr(evidence, name))
        loaded.save(tmp_path / "b.evidence")
        assert (tmp_path / "a.evidence").read_bytes() == (tmp_path / "b.evidence").read_bytes()

    def test_a_list_of_boxes_round_trips(self, tmp_path: Path) -> None:
        boxes = ConstraintHypotheses([Box(x=(0.1, 0.7)), Box(theta=(6.0, 7.0), x=(1.0, 2.0))])
        evidence = make_evidence(make_record(hypotheses=boxes))
        evidence.save(tmp_path / "a.evidence")
        assert_equal(Evidence.load(tmp_path / "a.evidence"), evidence)

    def test_samples_are_read_when_they_are_asked_for(self, tmp_path: Path) -> None:
        evidence, path = make_evidence(), tmp_path / "a.evidence"
        evidence.save(path)
        damage(path, evidence.samples.violations)
        content = path.read_bytes()
        loaded = Evidence.load(path)
        for name in PROPERTIES:
            np.testing.assert_array_equal(getattr(loaded, name), getattr(evidence, name))
        assert loaded.find(Task(TASKS.start[1], TASKS.goal[1])) == 1
        for use in (
            lambda: loaded.samples,
            lambda: loaded.log_weight,
            lambda: loaded.select([0]).samples,
        ):
            with pytest.raises(StoreError, match=r"a\.evidence: altered"):
                use()
        assert path.read_bytes() == content

    @pytest.mark.parametrize("part", ["summary", "tasks"])
    def test_a_damaged_summary_is_refused_at_once(self, part: str, tmp_path: Path) -> None:
        evidence, path = make_evidence(), tmp_path / "a.evidence"
        evidence.save(path)
        damage(path, getattr(evidence, part)[1])
        with pytest.raises(StoreError, match=r"a\.evidence: altered"):
            Evidence.load(path)

    def test_the_first_samples_read_are_kept(self, tmp_path: Path) -> None:
        evidence, path = make_evidence(), tmp_path / "a.evidence"
        evidence.save(path)
        loaded = Evidence.load(path)
        other = make_evidence(samples=make_samples(seed=1))
        other.save(path)
        np.testing.assert_array_equal(loaded.samples.violations, evidence.samples.violations)
        path.unlink()
        assert loaded.samples is loaded.samples

    def test_the_file_names_its_kind_and_its_arrays(self, tmp_path: Path) -> None:
        make_evidence().save(tmp_path / "a.evidence")
        with open_file(tmp_path / "a.evidence", KIND, VERSION) as stored:
            assert stored.names[:3] == ("tasks/start", "tasks/goal", "summary/avoid_probability")
            assert stored.header["problem"]["beta"] == 0.5

    def test_another_kind_is_refused(self, tmp_path: Path) -> None:
        from swerve.base import store

        store.write(tmp_path / "a.evidence", "swerve-nominal", 1, {}, {})
        with pytest.raises(StoreError, match="expected a file of kind 'swerve-evidence'"):
            Evidence.load(tmp_path / "a.evidence")


class TestFind:
    def test_every_task_is_found(self) -> None:
        evidence = make_evidence()
        assert evidence.num_tasks == 3
        for k in range(3):
            task = Task(TASKS.start[k], TASKS.goal[k])
            assert evidence.find(task) == evidence.match(task) == k

    @pytest.mark.parametrize("turns", [-3, -1, 1, 5])
    def test_angles_wrap(self, turns: int) -> None:
        shift = np.array([TWO_PI * turns, 0.0])
        evidence = make_evidence()
        assert evidence.find(Task(TASKS.start[2] + shift, TASKS.goal[2] - shift)) == 2
        across = Task(np.array([-1e-4, 1.0]), np.array([0.0, 0.0]))
        tasks = Task(np.array([[TWO_PI - 2e-4, 1.0]]), np.array([[TWO_PI, 0.0]]))
        assert make_evidence(tasks=tasks).find(across) == 0

    @pytest.mark.parametrize("part", ["start", "goal"])
    @pytest.mark.parametrize("column", [0, 1])
    @pytest.mark.parametrize("sign", [-1, 1])
    def test_tolerance_is_in_units_of_the_extent(self, part: str, column: int, sign: int) -> None:
        evidence = make_evidence()
        task = Task(TASKS.start[1], TASKS.goal[1])
        for share, found in ((0.99, 1), (1.01, None)):
            off = np.zeros(2)
            off[column] = sign * share * MATCH_TOLERANCE * SPACE.extent[column]
            assert evidence.find(task._replace(**{part: getattr(task, part) + off})) == found

    def test_the_nearest_of_several_is_taken(self) -> None:
        tasks = Task(np.array([[0.0, 1.0], [0.0, 1.004]]), np.zeros((2, 2)))
        evidence = make_evidence(tasks=tasks)
        assert evidence.find(Task(np.array([0.0, 1.0035]), np.zeros(2))) == 1
        assert evidence.find(Task(np.array([0.0, 1.0005]), np.zeros(2))) == 0

    def test_no_match_is_an_error_that_names_both(self) -> None:
        evidence = make_evidence()
        message = (
            r"demo_7: no evidence for start \(3, 5\.1\) and goal \(2, 2\); the nearest of 3 tasks "
            r"is start \(3, 5\), goal \(2, 2\)\. Sample this task too: "
            r"swerve\.sample\(nominal, tasks\)"
        )
        with pytest.raises(ValueError, match=message):
            evidence.match(Task(np.array([3.0, 5.1]), TASKS.goal[1]), "demo_7")
        with pytest.raises(ValueError, match="the task: no evidence for start"):
            evidence.match(Task(TASKS.start[0], TASKS.goal[1]))

    def test_goals_that_are_no_states_are_compared_by_value(self) -> None:
        record = make_record(goal_names=("height",))
        tasks = Task(TASKS.start, np.array([[0.0], [1000.0], [TWO_PI]]))
        evidence = make_evidence(record, tasks=tasks)
        assert evidence.find(Task(TASKS.start[1], np.array([1000.9]))) == 1
        assert evidence.find(Task(TASKS.start[1], np.array([1001.1]))) is None
        assert evidence.find(Task(TASKS.start[2], np.array([0.0]))) is None  # no angle
        assert evidence.find(Task(TASKS.start[0], np.array([9e-4]))) == 0
        assert evidence.find(Task(TASKS.start[0], np.array([1.1e-3]))) is None

    def test_there_may_be_no_goal_at_all(self) -> None:
        record = make_record(goal_names=())
        evidence = make_evidence(record, tasks=Task(TASKS.start, np.zeros((3, 0))))
        assert evidence.find(Task(TASKS.start[1], np.zeros(0))) == 1


class TestSelectAndJoin:
    @pytest.mark.parametrize("indices", [[1], [2, 0], [0, 1, 2], [1, 1]])
    def test_select_takes_tasks_in_the_order_given(self, indices: list[int]) -> None:
        evidence = make_evidence()
        some = evidence.select(indices)
        assert some.num_tasks == len(indices)
        for part in PARTS:
            for taken, all_of_it in zip(getattr(some, part), getattr(evidence, part), strict=True):
                np.testing.assert_array_equal(taken, all_of_it[indices])
        np.testing.assert_array_equal(some.log_ratio, evidence.log_ratio[indices])
        np.testing.assert_array_equal(some.log_weight, evidence.log_weight[indices])

    def test_what_was_selected_joins_again(self, tmp_path: Path) -> None:
        evidence = make_evidence()
        joined = evidence.select([0]).joined(evidence.select([1, 2]))
        assert_equal(joined, evidence)
        joined.save(tmp_path / "joined.evidence")
        assert_equal(Evidence.load(tmp_path / "joined.evidence"), evidence)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"method": "plain"}, "different method cannot be joined: 'importance' and 'plain'"),
            ({"num_trajectories": 7}, "different num_trajectories cannot be joined: 400 and 7"),
            ({"solver": "Grid()"}, r"different solver cannot be joined: 'Toy\(\)' and 'Grid\(\)'"),
            ({"seed": 3}, "different seed cannot be joined: 0 and 3"),
            ({"sampling_beta": 0.25}, r"different sampling_beta cannot be joined: 0\.5 and 0\.25"),
            (
                {"problem": make_record(beta=0.25)},
                r"different problems cannot be joined: .* beta 0\.5, .* beta 0\.25",
            ),
        ],
    )
    def test_what_differs_is_not_joined(self, change: dict[str, Any], message: str) -> None:
        evidence = make_evidence()
        with pytest.raises(ValueError, match=f"evidence of {message}"):
            evidence.joined(dataclasses.replace(evidence, **change))

    def test_problems_that_only_look_alike_are_not_joined(self) -> None:
        a, b = (make_evidence(make_record(mdp_digest=digest)) for digest in ("0", "1"))
        with pytest.raises(ValueError, match="different problems"):
            a.joined(b)
        narrow = StateSpace(SPACE.names, SPACE.angles, SPACE.bounds * [[1.0], [0.5]])
        with pytest.raises(ValueError, match="different problems"):
            a.joined(make_evidence(make_record(space=narrow, mdp_digest="0")))


class TestAtBeta:
    """Of evidence at beta 0.5; tests/test_temperature.py holds it against enumeration."""

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
