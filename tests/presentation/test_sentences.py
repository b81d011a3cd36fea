from __future__ import annotations

import numpy as np
import pytest
from support.synthetic import evidence_of_columns, make_demonstration, make_evidence, make_record

from swerve.answer import Inference, infer
from swerve.base import phrases
from swerve.constraints.boxes import Box
from swerve.constraints.predicate import Predicate
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.grid import grid
from swerve.inference.greedy import greedy
from swerve.inference.posterior import Prior
from swerve.presentation import sentences as wording

CELLS = grid(x=(0.0, 10.0, 10))  # the tasks start in 1, 5 and 9


def with_chances(chances: list[float], num: int = 1000) -> Inference:
    """Cell k is entered by this share of the trajectories; demonstrations enter 1 and 5."""
    columns = np.zeros((3, num, 10), bool)
    for cell, chance in enumerate(chances):
        columns[:, : round(chance * num), cell] = True
    evidence = evidence_of_columns(columns, CELLS)
    return infer(evidence, [make_demonstration(0, "a"), make_demonstration(1, "b")])


class TestTitle:
    def test_has_the_first_cell_and_its_score(self) -> None:
        result = with_chances([0.1, 0.9, 0.1, 0.5, 0.1])
        assert wording.title(result) == "Cell 3: x [3, 4) at 1.39 ± 0.04 nats"

    def test_names_ties_and_counts_those_it_does_not_name(self) -> None:
        two = with_chances([0.5, 0, 0.5])
        assert wording.title(two).endswith("nats, tied with cell 2")
        many = with_chances([0.5] * 10)
        assert len(many.leaders) == 8
        assert wording.title(many).endswith("nats, tied with cells 2, 3, 4, 6, 7, 8 and 1 more")

    def test_of_the_paper_s_score(self) -> None:
        result = with_chances([0.1, 0.9, 0.1, 0.5])
        average = infer(result.evidence, result.demonstrations, score="average")
        assert wording.title(average) == "Cell 3: x [3, 4) at average violation 0.50 ± 0.01"

    def test_without_demonstrations_it_is_the_prior_ranking(self) -> None:
        result = infer(with_chances([0.1, 0.5]).evidence)
        assert wording.title(result).startswith(
            "No demonstrations yet. Prior ranking: cell 1: x [1"
        )

    def test_where_nothing_is_left(self) -> None:
        everywhere = make_record(hypotheses=grid(x=(0.0, 10.0, 1)))
        result = infer(make_evidence(everywhere), [make_demonstration(0)])
        assert wording.title(result) == "No hypothesis is left: demonstrations enter all 1"

    def test_cuts_a_long_name_on_one_line(self) -> None:
        name = "a name\nof two lines, " + "and long " * 50
        hypotheses = ConstraintHypotheses([Predicate(name, lambda s: s[..., 0] > 99)])
        title = wording.title(infer(make_evidence(make_record(hypotheses=hypotheses))))
        assert "hypothesis 0: a name of two lines" in title
        assert "\n" not in title
        assert len(title) < 250


class TestSentence:
    def test_says_what_to_keep_out_of(self) -> None:
        assert wording.sentence(with_chances([0.1, 0, 0.5])) == (
            "2 demonstrations are best explained by keeping out of cell 2: x [2, 3) "
            "(1.39 ± 0.04 nats)."
        )

    def test_says_where_nothing_stands_out(self) -> None:
        assert wording.sentence(with_chances([])).startswith(
            "No hypothesis explains 2 demonstrations noticeably better than no constraint does"
        )

    def test_says_that_there_are_no_demonstrations(self) -> None:
        text = wording.sentence(infer(with_chances([0.1, 0.5]).evidence))
        assert text.startswith("There are no demonstrations yet")
        assert "cell 1: x [1, 2)" in text

    def test_says_that_nothing_is_left(self) -> None:
        result = infer(
            make_evidence(make_record(hypotheses=grid(x=(0.0, 10.0, 2)))),
            [make_demonstration(0), make_demonstration(1)],
        )
        assert wording.sentence(result).startswith("No hypothesis is left: each of the 2 is")


class TestSettings:
    def test_has_all_that_the_answer_depends_on(self) -> None:
        result = with_chances([0.1, 0.5])
        text = wording.settings(result)
        for part in (
            result.evidence.problem.summary,
            "2 demonstrations, 2 tasks",
            "1,000 trajectories a task from Toy(), plain weights, seed 0",
        ):
            assert part in text


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (13.372, 0.052, "13.37 ± 0.05"),
        (13.372, 0.14, "13.4 ± 0.1"),
        (0.7, 0.00999, "0.70 ± 0.01"),
        (11.3, 0.97, "11 ± 1"),
        (11.3, 14.0, "11 ± 14"),
        (0.107, 0.0003, "0.1070 ± 0.0003"),
        (11.312, 0.0, "11.31"),
    ],
)
def test_a_score_ends_at_the_first_digit_of_its_error(value, error, text) -> None:
    assert phrases.measured(value, error) == text


def test_lists_of_boxes_are_hypotheses_not_cells() -> None:
    record = make_record(hypotheses=ConstraintHypotheses([Box(x=(3.0, 4.0)), Box(x=(6.0, 7.0))]))
    result = infer(make_evidence(record))
    assert wording.noun(result) == "hypothesis"
    assert wording.hypothesis(result, 1) == "hypothesis 1: x [6, 7)"
    assert phrases.counted(1, "hypothesis") == "1 hypothesis"
    assert phrases.counted(1200, "hypothesis") == "1,200 hypotheses"


def test_what_asks_or_is_cut_has_no_full_stop() -> None:
    assert phrases.ended("not to be trusted") == "not to be trusted."
    assert phrases.ended("another unit?") == "another unit?"
    assert phrases.ended(phrases.cut("a long sentence", 6)) == "a lon…"


@pytest.mark.parametrize(("num", "few"), [(1000, False), (100, True)])
def test_picking_that_ended_by_few_trajectories_says_so(num: int, few: bool) -> None:
    result = with_chances([0.1, 0.9, 0.1, 0.5], num)
    picks = greedy(result, threshold=0.3)
    assert [pick.hypothesis for pick in picks] == [3]
    said = wording.ended(result, picks)
    text = "only some 50 trajectories of a task avoid what is picked, too few to tell: raise "
    assert said.endswith(f"{text}--samples") is few
    assert ("too few" in said) is few


def test_lines_do_not_break_inside_a_value() -> None:
    text = "cell 5: theta [3.14, 3.77), omega [-1.2, 0) at 13.4 ± 0.1 nats, Grid(num=(180, 361))"
    for width in np.linspace(1.8, 6.0, 20):
        lines = phrases.wrapped(text, width, 10.0).replace("\N{NO-BREAK SPACE}", " ").split("\n")
        assert " ".join(lines) == text
        for value in ("[3.14, 3.77)", "[-1.2, 0)", "13.4 ± 0.1 nats", "(180, 361)"):
            assert any(value in line for line in lines)


class TestBelief:
    def test_has_the_bayes_factor(self) -> None:
        result = with_chances([0.1, 0.9, 0.1, 0.5])
        assert result.log_bayes_factor > 0.0
        factor = phrases.times(result.log_bayes_factor)
        assert f"; Bayes factor of a constraint against none {factor}; 95 %" in result.belief

    @pytest.mark.parametrize("prior", [1.0, [1.0, 0.0, 0.0, 0.0, 0.0]])
    def test_has_none_where_the_prior_rules_out_every_constraint(self, prior: Prior) -> None:
        """As in JSON; and the headline, which is about the data alone, says it too."""
        columns = np.zeros((3, 1000, 4), bool)
        columns[:, :900, 3] = True
        evidence = evidence_of_columns(columns, grid(x=(0.0, 8.0, 4)))
        result = infer(evidence, [make_demonstration(0)], prior=prior)
        assert result.belief == (
            "Posterior: no constraint 100 %; no Bayes factor, since the prior rules out every "
            "constraint; 95 % credible set: no constraint."
        )
        assert result.to_json()["none"]["log_bayes_factor"] is None
        assert result.headline.endswith("nats), although the prior rules out every constraint.")
        assert wording.title(result).endswith(
            " nats, although the prior rules out every constraint"
        )

    def test_says_that_the_first_is_ruled_out_by_its_prior(self) -> None:
        columns = np.zeros((3, 1000, 4), bool)
        columns[:, :900, 3] = columns[:, :300, 2] = True
        evidence = evidence_of_columns(columns, grid(x=(0.0, 8.0, 4)))
        demonstrations = [make_demonstration(0)]
        result = infer(evidence, demonstrations, prior=[0.5, 0.0, 0.0, 0.5, 0.0])
        assert result.headline.endswith("nats), although the prior rules out this hypothesis.")
        assert "Bayes factor of a constraint against none 1.4; 95 %" in result.belief
        certain = infer(evidence, demonstrations, prior=0.0)
        assert certain.headline == infer(evidence, demonstrations).headline
        assert certain.belief.startswith("Posterior: no constraint 0, cell 3 ")
        factor = certain.to_json()["none"]["log_bayes_factor"]
        assert f"a constraint against none {phrases.times(factor)}; 95 %" in certain.belief

    def test_has_none_before_anything_is_seen(self) -> None:
        assert "Bayes" not in infer(with_chances([0.5]).evidence).belief

    @pytest.mark.parametrize(
        ("nats", "text"),
        [
            (-np.inf, "0"),
            (-30.0, "10^-13"),
            (-3.0, "0.05"),
            (0.0, "1"),
            (0.5, "1.6"),
            (3.0, "20"),
            (13.37, "640,000"),
            (30.0, "10^13"),
        ],
    )
    def test_factors_have_two_digits(self, nats: float, text: str) -> None:
        assert phrases.times(nats) == text
