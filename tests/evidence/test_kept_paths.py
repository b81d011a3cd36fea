"""Trajectories kept for pictures take no more room than they need."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from support.synthetic import TASKS, make_evidence, make_record, make_samples

from swerve import Evidence, Task, Walker, sample, windows
from swerve.evidence.samples import Samples, joined_samples, kept_paths
from swerve.problem.problem import Problem
from swerve.solvers.learn import learn

STATES = np.array([[[1.0], [2.0], [2.0], [2.0], [2.0]], [[1.0], [1.0], [3.1], [3.1], [3.1]]])


def test_paths_are_cut_where_all_of_them_rest() -> None:
    kept = kept_paths(STATES)
    np.testing.assert_array_equal(kept, STATES[:, :3].astype(np.float32))
    assert kept.dtype == np.float32
    np.testing.assert_array_equal(kept_paths(STATES[:, :3]), kept)
    for states, num in ((STATES[:1], 2), (STATES[:, 3:], 2), (STATES[:0], 2)):
        assert kept_paths(states).shape[1] == num


def test_joined_paths_rest_where_they_end() -> None:
    samples = make_samples()
    short = samples._replace(kept=samples.kept[:, :, :3])
    joined = joined_samples([samples, short])
    assert joined.kept.shape == (6, *samples.kept.shape[1:])
    np.testing.assert_array_equal(joined.kept[:3], samples.kept)
    np.testing.assert_array_equal(joined.kept[3:, :, :3], short.kept)
    assert (joined.kept[3:, :, 3:] == short.kept[:, :, -1:]).all()
    evidences = [make_evidence(samples=part) for part in (samples, short)]
    moved = dataclasses.replace(evidences[1], tasks=Task(TASKS.start + 0.3, TASKS.goal))
    assert isinstance(evidences[0].joined(moved).samples, Samples)


def test_a_summary_is_that_of_the_whole_paths() -> None:
    """Of states that have float32 values, as simulated ones have."""
    record, samples = make_record(), make_samples()
    whole = np.repeat(samples.kept, [1, 1, 1, 1, 1, 40], axis=2).astype(np.float32)
    first = make_evidence(record, samples._replace(kept=whole)).samples
    assert kept_paths(whole[0]).shape[1] == 6
    np.testing.assert_array_equal(first.kept[0, :, :6], kept_paths(whole[0]))


def test_a_task_of_few_steps_takes_few_bytes(tmp_path: Path) -> None:
    """However long the horizon is."""
    walker = Walker(bounds=((-1.0, 9.0), (-2.0, 2.0)))
    boxes = windows(x=(1.0, 7.0, 0.75), y=(-1.5, 1.5, 0.75))
    problem = Problem(walker, boxes, beta=9.0, measure="counting")
    tasks = Task(np.array([[0.0, 0.0], [0.0, 1.0]]), np.array([[7.98, 0.0], [2.0, 0.0]]))
    evidence = sample(learn(problem, "soft-paths"), tasks)
    evidence.save(tmp_path / "a.evidence")
    assert (tmp_path / "a.evidence").stat().st_size < 2 * 100_000
    samples = Evidence.load(tmp_path / "a.evidence").samples
    assert samples.kept.dtype == np.float32
    assert samples.kept.shape[2] - 1 <= samples.length.max()
    ends = samples.kept[:, :, -1]
    assert (np.abs(ends - tasks.goal[:, None]) <= 0.5).all()
