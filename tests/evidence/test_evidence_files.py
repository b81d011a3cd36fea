"""Evidence in files: the same after a round trip, refused where it is damaged."""

from __future__ import annotations

import json
import math
import pickle
from pathlib import Path

import numpy as np
import pytest
from support.evidence_parts import assert_equal
from support.synthetic import TASKS, make_evidence, make_record, make_samples

from swerve import infer
from swerve.base.space import Task
from swerve.base.store import StoreError, open_file
from swerve.constraints.boxes import Box
from swerve.evidence.evidence import KIND, VERSION, Evidence
from swerve.hypotheses.base import ConstraintHypotheses

PROPERTIES = (
    "violation_probability",
    "log_ratio",
    "standard_error",
    "log_partition",
    "kl",
    "effective_sample_size",
)


def damage(path: Path, array: np.ndarray) -> None:
    """Flip one bit of an array inside a file."""
    content = bytearray(path.read_bytes())
    at = bytes(content).find(array.tobytes())
    assert at > 0
    content[at] ^= 1
    path.write_bytes(content)


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

    def test_plain_evidence_with_known_constraints_reads_the_rewards_alone(
        self, tmp_path: Path
    ) -> None:
        record, path = make_record(known=(Box(x=(0.1, 0.3)),)), tmp_path / "a.evidence"
        made = make_evidence(record)
        reward = made.samples.total_reward.copy()
        reward[0, :3] = -math.inf
        samples = made.samples._replace(total_reward=reward)
        evidence = make_evidence(record, samples, method="plain")
        evidence.save(path)
        again = pickle.loads(pickle.dumps(Evidence.load(path)))  # noqa: S301
        damage(path, samples.violations)
        loaded = Evidence.load(path)
        infer(loaded)
        share = 1.0 / np.isfinite(reward).sum(axis=1)
        assert share[0] > share[1]
        for found, expected in (
            (loaded, share),
            (loaded.select([1, 0]), share[[1, 0]]),
            (loaded.joined(loaded.select([1])), [*share, share[1]]),
            (again, share),
        ):
            np.testing.assert_array_equal(found.resolution, expected)
        with pytest.raises(StoreError, match=r"a\.evidence: altered"):
            _ = loaded.samples
        evidence.save(path)
        damage(path, samples.total_reward)
        with pytest.raises(StoreError, match=r"a\.evidence: altered"):
            _ = Evidence.load(path).resolution

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


def test_evidence_on_boxes_with_open_sides_is_saved(tmp_path: Path) -> None:
    boxes = ConstraintHypotheses([Box(x=(-math.inf, 2.0)), Box(x=(2.0, math.inf))])
    evidence = make_evidence(make_record(hypotheses=boxes, known=(Box(x=(9.5, math.inf)),)))
    evidence.save(tmp_path / "a.evidence")
    back = Evidence.load(tmp_path / "a.evidence").problem
    assert back.fingerprint == evidence.problem.fingerprint
    json.dumps(back.to_json(), allow_nan=False)
    assert [back.hypotheses.name(k) for k in range(2)] == ["x [-inf, 2)", "x [2, inf)"]
