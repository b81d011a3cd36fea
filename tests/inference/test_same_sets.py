"""Hypotheses that are the same set share every error, so their difference has none."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.synthetic import evidence_of_columns, make_demonstration

from swerve import Box, Evidence, infer
from swerve.base.space import TWO_PI
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.inference.posterior import posterior

TWICE = ConstraintHypotheses(
    [
        Box(x=(8.0, 9.0)),
        Box(x=(6.0, 7.0)),
        Box(theta=(0.0, TWO_PI), x=(8.0, 9.0)),
        Box(x=(3.0, 4.0)),
    ]
)
NUM = 20  # demonstrations


def entered_by_all(num_avoiding: int = 0) -> Evidence:
    """All of 500 trajectories enter the set that is there twice; a fifth enters the next."""
    columns = np.zeros((1, 500, 4), bool)
    columns[0, num_avoiding:, [0, 2]] = True
    columns[0, :100, 1] = True
    return evidence_of_columns(columns, TWICE)


def resolved(log_ratio: tuple[float, float]) -> Evidence:
    """The ratio of the set as it was worked out for each of its two hypotheses."""
    evidence = entered_by_all()
    ratio = evidence.summary.log_ratio.copy()
    error = np.full((1, 4), np.nan)
    ratio[0, [0, 2]], error[0, [0, 2]] = log_ratio, 0.05
    summary = evidence.summary._replace(log_ratio=ratio, log_ratio_error=error)
    return dataclasses.replace(evidence, summary=summary)


@pytest.mark.parametrize("evidence", [entered_by_all(), resolved((-8.0, -8.0))])
def test_two_names_of_a_set_are_equally_probable_without_an_error(evidence: Evidence) -> None:
    """Taken for independent, the errors of 20 demonstrations would be half of the probability."""
    found = infer(evidence, [make_demonstration()] * NUM).posterior
    np.testing.assert_allclose(found.hypotheses[[0, 2]], 0.5, atol=1e-12)
    np.testing.assert_allclose(found.error[[0, 2]], 0.0, atol=1e-12)


def test_the_shared_error_is_that_of_both_together() -> None:
    """Against another answer, the two go up and down together."""
    result = infer(resolved((-0.4, -0.4)), [make_demonstration()] * 3)
    value = np.concatenate([[result.posterior.none], result.posterior.hypotheses])
    step = np.array([1e-6, 0.0, 1e-6, 0.0])
    slope = (posterior(result.log_likelihood + step, result.prior) - value) / 1e-6
    stated = np.concatenate([[result.posterior.none_error], result.posterior.error])
    island = infer(
        dataclasses.replace(
            result.evidence,
            summary=result.evidence.summary._replace(
                log_ratio_error=np.array([[0.0, np.nan, 0.0, np.nan]])
            ),
        ),
        [make_demonstration()] * 3,
    ).posterior
    island_error = np.concatenate([[island.none_error], island.error])
    expected = np.hypot(3 * 0.05 * np.abs(slope), island_error)
    np.testing.assert_allclose(stated, expected, rtol=1e-4)


def test_ratios_that_were_worked_out_apart_have_errors_of_their_own() -> None:
    """As in evidence of earlier versions."""
    found = infer(resolved((-8.0, -8.0 + 1e-9)), [make_demonstration()] * NUM).posterior
    np.testing.assert_allclose(found.error[[0, 2]], 0.25 * np.sqrt(2.0) * NUM * 0.05, rtol=1e-3)


def test_the_order_of_two_names_needs_no_samples() -> None:
    result = infer(entered_by_all(), [make_demonstration()])
    assert result.verdict(0) == "settled"
    columns = np.zeros((1, 500, 4), bool)
    columns[0, :250, [0, 2]] = True
    assert (
        infer(evidence_of_columns(columns, TWICE), [make_demonstration()]).verdict(0) == "settled"
    )
