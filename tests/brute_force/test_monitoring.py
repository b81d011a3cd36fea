"""What a monitor believes after each state is what brute force says of the trajectories left."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force.chunks import CHUNKS, over
from brute_force.comparing import Differences
from brute_force.reference.answers import Answer, answer, with_recordings
from brute_force.reference.cases import Assumptions, Case, assuming, random_case
from brute_force.reference.demonstrated import ahead, prefix_log_likelihood
from brute_force.reference.geometry import AmbiguousError
from brute_force.reference.recordings import Recording
from brute_force.sampled_evidence import record_of
from brute_force.translation import demonstration_of

from swerve import Course, Evidence, Monitor, Task, follow
from swerve.evidence.exact import ExactAnswer, KeptTrajectories, exact_evidence
from swerve.problem.record import ProblemRecord

CLOSE = 1e-5  # nats: beliefs of a monitor are float32


class Exactly:
    """A foresight that knows every trajectory that is left of one demonstration."""

    def __init__(self, case: Case, recording: Recording, fingerprint: str) -> None:
        self.fingerprint, self._case, self._recording = fingerprint, case, recording
        self._prefix = case.paths[recording.task].actions[recording.path]

    def towards(self, goal: np.ndarray):
        case, recording = self._case, self._recording
        return lambda state, step: ahead(case, recording.task, self._prefix, step)


def evidence_of(case: Case, truth: Answer, record: ProblemRecord, task: int) -> Evidence:
    """Return evidence of one task that says what the reference says."""
    paths, num = case.paths[task], 4
    kept = KeptTrajectories(
        paths.states[:num],
        paths.reward[:num],
        paths.length[:num],
        np.packbits(case.entered[task][:num], axis=-1, bitorder="little"),
    )
    found = ExactAnswer(truth.tasks[task].log_partition, truth.log_ratio[task], kept)
    return exact_evidence(record, Task(case.starts[task], case.goals[task]), found, "exact", 0)


def compared(seed: int) -> list[str]:
    case, note = random_case(seed), Differences(seed, CLOSE)
    rows = [k for k, r in enumerate(case.recordings) if r.way in ("plain", "timed")]
    if not rows or any(region.about_actions for region in case.layout.regions):
        return []
    assumed = case.assumed
    plain = Assumptions(assumed.prior, assumed.tolerance, None, assumed.clearance)
    try:
        case = assuming(with_recordings(case, rows), plain)
    except AmbiguousError:
        return []
    record = record_of(case)
    for row in range(len(rows)):
        one = with_recordings(case, [row])
        _follow(note, one, answer(one), record)
    return note.found


def _follow(note: Differences, case: Case, truth: Answer, record: ProblemRecord) -> None:
    """Compare the belief after each state of the only demonstration, and at its end."""
    (recording,), assumed = case.recordings, case.assumed
    foresight = Exactly(case, recording, record.fingerprint)
    monitor = Monitor(
        evidence_of(case, truth, record, recording.task),
        Task(case.starts[recording.task], case.goals[recording.task]),
        foresight,
        prior=assumed.prior,
        tolerance=assumed.tolerance,
        clearance=assumed.clearance,
    )
    num = len(recording.states)
    expected = [prefix_log_likelihood(truth, recording, step) for step in range(num)]
    expected.append(truth.log_likelihood)
    beliefs = [_posterior(truth.prior, value) for value in expected]
    if any(belief is None for belief in beliefs):
        with pytest.raises(ValueError, match="P\\(no constraint\\) is 0"):
            follow(monitor, demonstration_of(case, recording))
        return
    course: Course = follow(monitor, demonstration_of(case, recording))
    note.numbers("log_likelihood", course.log_likelihood, np.array(expected))
    found = np.c_[course.none, course.hypotheses]
    note.numbers("belief", found, np.array(beliefs))


def _posterior(prior: np.ndarray, log_likelihood: np.ndarray) -> np.ndarray | None:
    joint = prior * np.exp(np.r_[0.0, log_likelihood])
    return joint / joint.sum() if joint.sum() > 0.0 else None


@pytest.mark.parametrize("seeds", CHUNKS, ids=str)
def test_beliefs_along_the_way(seeds: range) -> None:
    over(seeds, compared)
