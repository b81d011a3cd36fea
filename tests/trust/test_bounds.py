"""What is said of scores that are bounds, and what can be done about them."""

from __future__ import annotations

import numpy as np
import pytest
from support.synthetic import evidence_of_columns, make_demonstration

from swerve import Evidence, Inference, grid, infer
from swerve.inference.unresolved import worth_resolving

EVERYWHERE = 6  # the cell that all trajectories enter
NOT_TRIED = (
    f"hypothesis {EVERYWHERE} was not tried with the hypothesis in force: swerve.resolve does "
    "this, and so does swerve infer without --no-resolve, as far as the time goes"
)


@pytest.fixture
def evidence() -> Evidence:
    columns = np.zeros((1, 1000, 10), bool)
    columns[0, :, EVERYWHERE] = True
    columns[0, :300, 2] = True
    return evidence_of_columns(columns, grid(x=(0.0, 10.0, 10)), solver="Grid(num_points=21)")


def said(evidence: Evidence, num_avoiding: int, num_entering: int, **judged: object) -> str:
    """Return what is said of bounds, for demonstrations that avoid and that enter the cell."""
    shown = [make_demonstration(name=f"out{k}") for k in range(num_avoiding)]
    shown += [make_demonstration(name=f"in{k}", x=6.5) for k in range(num_entering)]
    result: Inference = infer(evidence, shown, **judged)  # pyright: ignore[reportArgumentType]
    return "; ".join(text for text in result.warnings if "bound" in text)


def test_what_resolving_can_change_is_told(evidence: Evidence) -> None:
    text = said(evidence, 2, 0)
    assert text.startswith(f"the score of hypothesis {EVERYWHERE} is only a lower bound: almost")
    assert text.endswith(NOT_TRIED)
    assert said(evidence, 20, 1, tolerance=0.1).endswith(NOT_TRIED)


def test_nothing_is_advised_that_cannot_help(evidence: Evidence) -> None:
    """By the tolerance it stays far behind; the average needs no more than the samples tell."""
    text = said(evidence, 1, 40, tolerance=0.05)
    assert "is only a lower bound" in text
    assert "not tried" not in text
    assert "not tried" not in said(evidence, 2, 0, score="average")


def test_a_score_by_the_tolerance_alone_is_no_bound(evidence: Evidence) -> None:
    """Where every demonstration ignores it, the score holds no ratio."""
    shown = [make_demonstration(x=6.5)] * 3
    result = infer(evidence, shown, tolerance=0.05)
    assert result.log_likelihood[EVERYWHERE] == pytest.approx(3 * np.log(0.05))
    assert not result.is_lower_bound.any()
    assert not result.is_open.any()
    assert not len(worth_resolving(result))
    assert not any("bound" in text for text in result.warnings)
