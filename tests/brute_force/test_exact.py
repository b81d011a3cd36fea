"""Exact solvers and all inference from their answers agree with brute force."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from brute_force.chunks import CHUNKS, over
from brute_force.comparing import (
    Differences,
    compare_evidence,
    compare_greedy,
    compare_inference,
    compare_least_tolerance,
    compare_one_by_one,
    compare_pair,
)
from brute_force.reference.answers import Answer, answer
from brute_force.reference.cases import Case, random_case
from brute_force.reference.demonstrated import divergence
from brute_force.reference.worlds import TableWorld
from brute_force.translation import demonstrations_of, inferred, problem_of, tasks_of

from swerve import Enumeration, Evidence, Tabular, infer, learn, sample
from swerve import divergence as library_divergence

CLOSE = 3e-5  # nats: rewards are sums in float32


def compared(seed: int, folder: Path) -> list[str]:
    case = random_case(seed)
    truth, note = answer(case), Differences(seed, CLOSE)
    problem = problem_of(case)
    is_table = isinstance(case.world, TableWorld)
    nominal = learn(problem, Tabular() if is_table and seed % 2 else Enumeration())
    evidence = sample(nominal, tasks_of(case))
    compare_evidence(note, evidence, truth)
    if seed % 5 == 0:
        evidence = _there_and_back(note, evidence, folder, problem.record.needs_code)
    inference = inferred(case, evidence)
    compare_inference(note, inference, truth)
    compare_least_tolerance(note, inference, truth)
    if case.recordings:
        _with_demonstrations(note, truth, inference, nominal, seed)
        _divergence(note, case, truth, problem)
    return note.found


def _there_and_back(
    note: Differences, evidence: Evidence, folder: Path, needs_code: bool
) -> Evidence:
    """Return evidence that has been taken apart, joined, written and read."""
    parts = [evidence.select([k]) for k in range(evidence.num_tasks)]
    joined = parts[0].joined(*parts[1:])
    note.numbers("joined", joined.log_ratio, evidence.log_ratio, 0.0)
    joined.save(folder / "evidence.npz")
    read = Evidence.load(folder / "evidence.npz")
    note.numbers("read", read.log_partition, evidence.log_partition, 0.0)
    return dataclasses.replace(read, problem=evidence.problem) if needs_code else read


def _with_demonstrations(note: Differences, truth: Answer, inference, nominal, seed: int) -> None:
    generator = np.random.default_rng([seed, 1])
    options = [{}, {"threshold": 0.0}, {"odds": 0.5, "threshold": 0.01}, {"most": 1}]
    chosen = options[int(generator.integers(len(options)))]
    if seed % 2:
        compare_greedy(note, inference, truth, nominal, **chosen)
    else:
        compare_pair(note, inference, truth, nominal)
    assumed = truth.case.assumed
    empty = infer(
        inference.evidence,
        score=assumed.score,
        prior=assumed.prior,
        tolerance=assumed.tolerance,
        margin=assumed.margin,
        clearance=assumed.clearance,
    )
    compare_one_by_one(note, empty, inference, truth)


def _divergence(note: Differences, case: Case, truth: Answer, problem) -> None:
    log_partition = np.array([task.log_partition for task in truth.tasks])[case.task_of]
    got = library_divergence(problem, demonstrations_of(case), log_partition)
    note.numbers("divergence", got, divergence(case, log_partition))


@pytest.mark.parametrize("seeds", CHUNKS, ids=str)
def test_exact_answers_and_what_follows(seeds: range, tmp_path: Path) -> None:
    over(seeds, lambda seed: compared(seed, tmp_path))
