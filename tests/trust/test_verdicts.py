"""Verdicts: what is said of samples that are fine, too few, or of a bad policy."""

from __future__ import annotations

import dataclasses
import json

import equinox as eqx
import numpy as np
import pytest
from support.guesses import Fixed, Guess
from support.reference import PENDULUM_TASK, short_pendulum
from support.routes import TASK, WALL, LatticeRoutes, Planted, routes
from support.synthetic import evidence_of_columns, make_demonstration, make_evidence

from swerve import Problem, grid, infer, learn, sample
from swerve.presentation import sentences as wording
from swerve.simulation.policies import LookAhead
from swerve.solvers.grid.grid import GridPolicy

GOOD = {
    "kl": 0.0,
    "log_partition": 3.0,
    "soft_value": 3.0,
    "effective_sample_size": 400.0,
    "island_log_partition": np.linspace(2.9, 3.1, 20),
}


@pytest.mark.parametrize(
    ("changes", "method", "text"),
    [
        ({"effective_sample_size": 12.0}, "smc", "not to be trusted: effective sample size 12 of"),
        ({"island_log_partition": np.linspace(0, 6, 20)}, "smc", "differ by 1.8 nats in log Z_0"),
        (
            {"island_log_partition": np.repeat([3, -np.inf], 10)},
            "smc",
            "differ in log Z_0: in one of them every trajectory enters a known constraint",
        ),
        ({"kl": 0.7}, "importance", "errors may be larger than stated: KL 0.70 nats"),
        ({"kl": 0.7}, "smc", None),
        ({"soft_value": 3.3}, "smc", "the solver's log Z_0 is 3.30, not 3.00 nats"),
        ({"soft_value": 3.3, "effective_sample_size": 130.0}, "smc", "log Z_0 is 3.30, not 3.00"),
        ({"soft_value": 3.3, "effective_sample_size": 130.0}, "importance", None),
        (
            {"soft_value": -np.inf},
            "smc",
            "stated: by the solver's soft value, known constraints close the start in",
        ),
    ],
)
def test_a_verdict_is_of_its_task_alone(changes: dict, method: str, text: str | None) -> None:
    found = make_evidence(method=method, solver="Grid(num_points=(9, 9))")
    columns = {
        name: np.array([value, changes.get(name, value), value]) for name, value in GOOD.items()
    }
    found = dataclasses.replace(found, summary=found.summary._replace(**columns))
    result = infer(found, [make_demonstration(k, f"demo_{k}") for k in range(3)])
    verdicts = [result.verdict(k) for k in range(3)]
    fine = ("settled", "ranking")
    assert verdicts[0].startswith(fine)
    assert verdicts[2].startswith(fine)
    assert verdicts[1].startswith(fine) if text is None else text in verdicts[1]
    said = [diagnostics["verdict"] for diagnostics in result.to_json()["diagnostics"]]
    assert said == verdicts
    json.dumps(said)


CELLS = grid(x=(0.0, 10.0, 10))


def chances(*violated: float, num: int = 1_000) -> np.ndarray:
    """Violations [1, N, 10]: of cell 5 and the next by shares of trajectories, of others none."""
    generator = np.random.default_rng(0)
    columns = np.zeros((1, num, 10), bool)
    for cell, share in enumerate(violated, start=5):
        columns[0, :, cell] = generator.permutation(np.arange(num) < share * num)
    return columns


def test_a_clear_ranking_is_settled() -> None:
    evidence = evidence_of_columns(chances(0.9, 0.5, 0.1, 0.001), CELLS)
    result = infer(evidence, [make_demonstration()])
    assert result.verdict(0) == "settled"
    assert result.verdicts() == "1 of 1 tasks settled"


def test_more_samples_are_asked_for_where_they_would_settle_it() -> None:
    """And that many do: the verdict on so many with the same shares is settled."""
    shares = (0.52, 0.50, 0.3, 0.1)
    result = infer(evidence_of_columns(chances(*shares), CELLS), [make_demonstration(name="one")])
    text = result.verdict(0)
    assert text.startswith("ranking of the first 3 not settled: raise --samples to about ")
    clear = infer(evidence_of_columns(chances(0.9, *shares), CELLS), [make_demonstration()])
    first = "ranking of the first 3 not settled (the first is): raise --samples to about "
    assert clear.verdict(0).startswith(first)
    needed = int(text.rsplit(" ", 1)[1].replace(",", ""))
    assert 5_000 < needed < 50_000
    assert result.verdicts() == f"0 of 1 tasks settled\n  one: {text}"
    enough = infer(evidence_of_columns(chances(*shares, num=needed), CELLS), [make_demonstration()])
    assert enough.verdict(0) == "settled"
    short = chances(*shares, num=int(0.8 * needed))
    assert infer(evidence_of_columns(short, CELLS), [make_demonstration()]).verdict(0) != "settled"


def test_equal_scores_are_never_settled() -> None:
    columns = chances(0.5, 0.5, 0.3, 0.1)
    columns[0, :, 6] = columns[0, ::-1, 5]
    result = infer(evidence_of_columns(columns, CELLS), [make_demonstration()])
    assert result.verdict(0).endswith("not settled, and more samples will not settle it")


def test_hypotheses_that_explain_nothing_need_no_order() -> None:
    result = infer(evidence_of_columns(chances(0.5), CELLS), [make_demonstration()])
    assert result.log_likelihood[result.ranking[1]] == result.log_likelihood[result.ranking[2]]
    assert result.verdict(0) == "settled"


def test_hypotheses_far_behind_the_first_need_no_order() -> None:
    """One demonstration leaves the second 3.9 nats behind, two 7.8 +- 0.7, three 11.7 +- 1.0."""
    evidence = evidence_of_columns(chances(0.99, 0.51, 0.5, 0.1), CELLS)
    one, two, three = (infer(evidence, [make_demonstration()] * num) for num in (1, 2, 3))
    for result in (one, two):
        assert result.verdict(0).startswith("ranking of the first 3 not settled (the first is)")
    assert three.verdict(0) == "settled"


def test_an_answer_that_is_not_to_be_trusted_says_so_alone() -> None:
    """What is said of bounds and of odd demonstrations would be of the few that are left."""
    evidence = evidence_of_columns(chances(0.9), CELLS)
    summary = evidence.summary._replace(end=evidence.tasks.goal, end_reach=np.full((1, 2), 0.01))
    evidence = dataclasses.replace(evidence, summary=summary)
    odd = make_demonstration()
    odd = dataclasses.replace(odd, states=np.vstack([odd.states, odd.states[-1] + [2.0, 0]]))
    fine = infer(evidence, [odd])
    assert "not to be trusted" not in fine.headline
    assert len(fine.warnings) == 1
    lost = dataclasses.replace(
        evidence,
        method="smc",
        summary=summary._replace(
            effective_sample_size=np.array([50.0]),
            avoid_probability=np.full((1, 10), 0.01),
            log_ratio_error=np.full((1, 10), np.nan),
        ),
    )
    result = infer(lost, [odd])
    assert (result.is_lower_bound | result.struck_out).all()
    assert result.is_lower_bound.sum() >= 9
    assert result.headline.endswith("by samples that are not to be trusted.")
    (warning,) = result.warnings
    assert warning.startswith("not to be trusted: the effective sample size is too low")


def test_the_verdict_is_about_the_score_that_ranks() -> None:
    """Of two that are almost certain, probabilities may be told apart where nats cannot."""
    columns = chances(0.999, 0.9935, 0.5, 0.1, num=2_000)
    evidence = evidence_of_columns(columns, CELLS)
    by_nats = infer(evidence, [make_demonstration()])
    by_average = infer(evidence, [make_demonstration()], score="average")
    assert by_nats.ranking[:4].tolist() == by_average.ranking[:4].tolist() == [5, 6, 7, 8]
    assert "not settled" in by_nats.verdict(0)
    assert by_average.verdict(0) == "settled"


def test_more_samples_are_not_asked_for_where_they_change_nothing() -> None:
    """A bound that samples cannot tell from the next stays one; a number stays as it is."""
    result = infer(evidence_of_columns(chances(1.0, 0.9985), CELLS), [make_demonstration()])
    assert result.is_lower_bound[5]
    assert result.verdict(0).endswith("not settled, and more samples will not settle it")


def test_exact_answers_are_exact() -> None:
    lattice = routes(LatticeRoutes(toll=1.0))
    assert infer(sample(learn(lattice), TASK)).verdicts() == "1 of 1 tasks exact"


FAR = short_pendulum(beta=4.0)


class Sharp(LookAhead):
    """The grid's policy, far too sure of itself."""

    problem: Problem = eqx.field(static=True)
    right: GridPolicy

    def value(self, state, step, goal):
        return 20.0 * self.right.value(state, step, goal)


class Elsewhere(LookAhead):
    """The grid's policy of another goal."""

    problem: Problem = eqx.field(static=True)
    right: GridPolicy

    def value(self, state, step, goal):
        return self.right.value(state, step, goal)


def right_policy(goal: np.ndarray) -> GridPolicy:
    [policy] = learn(FAR, "grid?num_points=121").policies(goal[None])  # pyright: ignore
    return policy


BAD = {
    "uniform": lambda: Guess(FAR, 0.0),
    "sharp": lambda: Sharp(FAR, right_policy(PENDULUM_TASK.goal)),
    "elsewhere": lambda: Elsewhere(FAR, right_policy(np.array([1.0, 2.0]))),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_policies_are_caught_by_their_weights(name: str) -> None:
    evidence = sample(Fixed(BAD[name]()), PENDULUM_TASK, 2_000, method="importance")
    result = infer(evidence)
    assert "not to be trusted" in result.verdict(0) or "errors may be larger" in result.verdict(0)
    assert result.warnings


@pytest.mark.parametrize("name", BAD)
def test_smc_is_right_or_says_that_it_is_not(name: str) -> None:
    truth = sample(learn(FAR, "grid?num_points=121"), PENDULUM_TASK, 20_000)
    evidence = sample(Fixed(BAD[name]()), PENDULUM_TASK, 2_000, method="smc")
    error = np.abs(evidence.log_partition[0] - truth.log_partition[0])
    said = ("not to be trusted", "errors may be larger than stated")
    assert error < 0.2 or infer(evidence).verdict(0).startswith(said)


def test_a_mode_that_no_sample_visits_is_seen() -> None:
    """By explorers alone: the weights look perfect."""
    lattice = routes(LatticeRoutes(toll=1.0))
    half = dataclasses.replace(lattice, known=[WALL, lattice.hypotheses.constraint(0)])
    result = infer(sample(Planted(lattice, half), TASK, 2_000))
    assert result.evidence.effective_sample_size[0] > 1_999.0
    assert result.verdict(0).startswith("not to be trusted: about ")


def test_another_beta_is_named_where_it_is_the_reason() -> None:
    evidence = make_evidence()  # at beta 0.5
    shown = [make_demonstration()]
    remedy = "sample at beta {0} itself: swerve.sample(nominal, tasks, beta={0})"
    far, hot, near = (infer(evidence.at_beta(beta), shown) for beta in (9.0, 0.2, 0.6))
    left = f"{far.evidence.effective_sample_size[0]:.0f} of 400"
    assert far.verdict(0) == (
        f"not to be trusted: effective sample size {left} at another beta: {remedy.format(9)}"
    )
    [warning] = [text for text in far.warnings if text.startswith("not to be trusted")]
    why = "The trajectories were sampled for beta 0.5, and weighed for"
    assert warning.endswith(f"{left}). {why} 9: {remedy.format(9)}")
    assert hot.evidence.effective_sample_size[0] > 200
    assert hot.verdict(0) == f"errors may be larger than stated: {remedy.format(0.2)}"
    [warning] = [text for text in hot.warnings if "below half" in text]
    assert warning.endswith(f"{why} 0.2: {remedy.format(0.2)}")
    assert not any("sampled for" in text or "sample at" in text for text in near.warnings)
    assert "sampled for beta 0.5" in wording.samples(near.evidence)
    assert "sampled for" not in wording.samples(evidence)


def test_equal_tasks_need_as_many_samples_as_one() -> None:
    """Scores, errors and gaps are three times as large: more tasks of the same samples add none."""
    evidence = evidence_of_columns(chances(0.52, 0.5, 0.3, 0.1), CELLS)
    once, three = infer(evidence), infer(evidence.select([0, 0, 0]))
    assert "raise --samples to about" in once.verdict(0)
    assert {three.verdict(k) for k in range(3)} == {once.verdict(0)}
