"""The report as a page."""

from __future__ import annotations

import base64
import dataclasses
import io
import re
from html import escape
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from support.pages import Page
from support.synthetic import (
    evidence_of_columns,
    make_demonstration,
    make_evidence,
    make_record,
    make_samples,
)

from swerve.answer import Inference, infer
from swerve.base import phrases
from swerve.base.space import TWO_PI, StateSpace, Task
from swerve.constraints.predicate import Predicate
from swerve.demonstrations.demonstration import Demonstration
from swerve.evidence.evidence import Evidence
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.grid import grid
from swerve.inference.greedy import greedy
from swerve.inference.ranking import Ranking
from swerve.presentation import html as hypertext
from swerve.presentation import report
from swerve.presentation.report import page, write_report
from swerve.trust import verdicts
from swerve.trust.sample_checks import Checks, sample_checks

EVIL = """</td><script>alert("1")</script><b onmouseover='x'>&amp; $x_{"""


@pytest.fixture(autouse=True)
def quick(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave pictures unrendered, which takes most of the time, but where they are looked at."""
    if "rendered" not in request.fixturenames:
        monkeypatch.setattr(hypertext, "_data", lambda figure: "data:image/png;base64,")


@pytest.fixture
def rendered() -> None:
    """Ask for rendered pictures."""


def ordinary() -> Inference:
    return infer(make_evidence(), [make_demonstration(0, "first"), make_demonstration(1, "second")])


class TestPage:
    def test_begins_with_the_answer(self) -> None:
        result = ordinary()
        text = Page(page(result)).words
        best = result.hypothesis_name(result.ranking[0])
        assert "2 demonstrations are best explained by keeping out of cell" in text[:300]
        assert best in text[:400]
        assert "times as likely under this constraint as under none. Next is cell" in text

    def test_refers_to_nothing_outside(self, rendered) -> None:
        html = page(ordinary())
        assert "http" not in html
        assert not re.search(r"@import|url\(|<script|<link|<iframe", html)
        for tag, attributes in Page(html).tags:
            assert not any(name.startswith("on") for name in attributes), tag
            for name in ("src", "srcset", "href"):
                assert (attributes.get(name) or "data:image/png;base64,").startswith("data:image/")

    def test_is_ready_for_phones_and_dark_rooms(self) -> None:
        html = page(ordinary())
        (viewport,) = [m for m in Page(html).all("meta") if m.get("name") == "viewport"]
        assert viewport["content"] == "width=device-width, initial-scale=1"
        assert "prefers-color-scheme: dark" in html
        assert html.startswith("<!DOCTYPE html>\n<html lang=")
        assert '<meta charset="utf-8">' in html[:100]

    def test_pictures_are_wide_and_for_phones_and_described(self, rendered) -> None:
        parsed = Page(page(ordinary()))
        assert len(parsed.all("img")) == len(parsed.all("source")) == 2
        for wide, narrow in zip(parsed.all("img"), parsed.all("source"), strict=True):
            assert wide["alt"]
            shapes = []
            for data in (wide["src"], narrow["srcset"]):
                raw = base64.b64decode((data or "").removeprefix("data:image/png;base64,"))
                shapes.append(imread(io.BytesIO(raw)).shape[1])
            assert shapes[0] > 1400 > shapes[1] > 600

    def test_explains_its_words(self) -> None:
        text = Page(page(ordinary())).words
        for words in (
            "Nats measure",
            "Struck out are",
            "Tied are",
            "Both numbers are alarms",
            "never sampled",
        ):
            assert words in text

    def test_lists_the_settings(self) -> None:
        result = ordinary()
        problem, text = result.evidence.problem, Page(page(result)).words
        for part in (
            problem.name,
            "12: 4 cells of theta [0, 6.28) × 3 cells of x [0, 9)",
            "states alone",
            "0.5 nats per unit of reward",
            "5 steps of 0.1 s",
            "400 trajectories a task, importance weights, seed 0",
            problem.fingerprint[:16],
        ):
            assert part in text

    def test_escapes_every_name(self) -> None:
        evil_space = StateSpace(("<i>a", "<i>b"), ("<i>a",), np.array([[0.0, TWO_PI], [0.0, 10.0]]))
        record = make_record(
            name=EVIL,
            space=evil_space,
            goal_names=("<i>a", "<i>b"),
            hypotheses=ConstraintHypotheses(
                [
                    Predicate(EVIL + "1", lambda s: s[..., 1] > 9.5),
                    Predicate(EVIL + "2", lambda s: s[..., 1] > 7.5),
                ]
            ),
            known=(Predicate(EVIL + "wall", lambda s: s[..., 1] > 99),),
        )
        evidence = make_evidence(record, solver=EVIL)
        few = evidence.summary._replace(effective_sample_size=np.full(3, 5.0))
        result = infer(make_evidence(record, solver=EVIL, summary=few),
                       [make_demonstration(0, EVIL + "demo")])  # fmt: skip
        html = page(result)
        parsed = Page(html)
        assert "<script" not in html
        assert not parsed.all("b")
        assert not parsed.all("i")
        for suffix in ("1", "2", "wall", "demo"):
            assert EVIL + suffix in parsed.text
        assert "start (<i>a, <i>b)" in parsed.text


class TestWarnings:
    def test_stand_before_the_first_picture(self) -> None:
        few = make_evidence().summary._replace(effective_sample_size=np.array([5.0, 300, 300]))
        result = infer(make_evidence(summary=few), [make_demonstration(0)])
        html = page(result)
        assert 'role="alert"' in html
        assert html.index(result.warnings[0]) < html.index("<img")
        assert "Warning: not to be trusted" in Page(html).words

    def test_one_that_asks_ends_in_its_question_mark(self) -> None:
        item = make_demonstration(0)
        times = np.linspace(0.0, 0.8, len(item.states))  # no unit explains it
        result = infer(make_evidence(), [dataclasses.replace(item, times=times)])
        assert result.warnings[-1].endswith("?")
        assert f"{escape(result.warnings[-1])}</p>" in page(result)

    def test_there_is_no_box_without_any(self) -> None:
        assert 'role="alert"' not in page(ordinary())


class TestRanking:
    def test_has_the_numbers_of_the_inference(self) -> None:
        result = ordinary()
        parsed = Page(page(result))
        head, *rows = parsed.tables[0]
        assert head[:4] == ["rank", "cell", "region", "score [nats]"]
        assert len(rows) == len(result.ranking)
        for row, index in zip(rows, result.ranking, strict=True):
            assert int(row[1]) == index
            assert row[2] == result.hypothesis_name(index)
            assert float(row[3].removeprefix("≥ ")) == pytest.approx(
                result.log_likelihood[index], abs=6e-4
            )
            assert float(row[4]) == pytest.approx(result.standard_error[index], abs=6e-4)
            found = result.posterior
            assert row[5] == phrases.probability(
                float(found.hypotheses[index]), float(found.error[index])
            )
            assert float(row[6]) == pytest.approx(result.average_violation[index], abs=6e-5)
        assert f"{len(rows)} cells left, {result.struck_out.sum()} struck out" in parsed.words

    def test_marks_ties_and_lower_bounds(self) -> None:
        columns = np.zeros((1, 400, 10), bool)
        columns[0, :, 3] = True
        columns[0, :200, [6, 7]] = True
        result = infer(evidence_of_columns(columns, grid(x=(0.0, 10.0, 10))))
        parsed = Page(page(result))
        rows = parsed.tables[0][1:]
        assert [row[0] for row in rows[:4]] == ["1", "2=", "2=", "4="]
        assert [row[3].startswith("≥") for row in rows[:3]] == [True, False, False]
        assert parsed.row_classes[0][1:3] == ["first", ""]

    def test_is_cut_and_says_how_many_more(self) -> None:
        cells = grid(theta=(0.0, TWO_PI, 100), x=(0.0, 9.0, 100))
        evidence = make_evidence(
            make_record(hypotheses=cells), make_samples(16, num_hypotheses=10_000)
        )
        parsed = Page(page(infer(evidence)))
        assert len(parsed.tables[0]) == 1 + report.MAX_HYPOTHESES
        assert "and 9,950 more cells." in parsed.words

    def test_of_the_paper_s_score(self) -> None:
        result = infer(make_evidence(), [make_demonstration(0)], score="average")
        text = Page(page(result)).words
        assert "would have entered this region with probability" in text
        assert "Ranked by" + "average violation" in text.replace("by average", "byaverage")


class TestNothing:
    def test_without_demonstrations_it_is_the_prior_ranking(self) -> None:
        parsed = Page(page(infer(make_evidence())))
        assert "There are no demonstrations yet" in parsed.words
        assert [row[0] for row in parsed.tables[1]] == ["task", "task 0", "task 1", "task 2"]
        assert "times as likely under this constraint" not in parsed.words

    def test_with_everything_struck_out(self) -> None:
        record = make_record(hypotheses=grid(x=(0.0, 10.0, 1)))
        parsed = Page(page(infer(make_evidence(record), [make_demonstration(0)])))
        assert "No hypothesis is left" in parsed.words
        assert "Warning: no hypothesis is left" in parsed.words
        assert "There is nothing to rank" in parsed.words
        assert len(parsed.all("img")) == 1


class TestTasks:
    def test_have_their_diagnostics(self) -> None:
        result = ordinary()
        evidence = result.evidence
        head, *rows = Page(page(result)).tables[1]
        assert head[2:4] == ["start (theta, x)", "goal (theta, x)"]
        assert [row[0] for row in rows] == ["first", "second"]
        assert rows[0][2:4] == ["0.1, 1", "1, 2"]
        for row, task in zip(rows, (0, 1), strict=True):
            assert row[1] == result.verdict(task)
            assert row[4] == f"{evidence.effective_sample_size[task]:.0f} of 400"
            assert float(row[5]) == pytest.approx(evidence.kl[task], abs=6e-3)
            assert float(row[6]) == pytest.approx(evidence.log_partition[task], abs=6e-3)
            assert float(row[7]) == pytest.approx(evidence.island_spread[task], abs=6e-4)
            assert row[8] == f"{evidence.distinct_share[task]:.0%}"

    def test_samples_are_checked_once_for_all_tasks(self, monkeypatch: pytest.MonkeyPatch) -> None:
        checked: list[Ranking] = []

        def counting(inference: Ranking) -> Checks:
            checked.append(inference)
            return sample_checks(inference)

        monkeypatch.setattr(verdicts, "sample_checks", counting)
        result = infer(make_evidence())
        assert report._tasks(result).count("<tr") == 1 + 3
        assert checked == [result]

    def test_low_samples_are_marked(self) -> None:
        few = make_evidence().summary._replace(effective_sample_size=np.array([5.0, 300, 300]))
        demonstrations = [make_demonstration(0), make_demonstration(1)]
        parsed = Page(page(infer(make_evidence(summary=few), demonstrations)))
        assert parsed.row_classes[1] == ["", "low", ""]
        assert parsed.tables[1][1][4] == "5 of 400, low"

    def test_many_demonstrations_of_one_task_are_counted(self) -> None:
        demonstrations = [make_demonstration(0, f"d{k}") for k in range(30)]
        parsed = Page(page(infer(make_evidence(), demonstrations)))
        assert parsed.tables[1][1][0] == "d0, d1, d2, d3, d4, d5, d6, d7 and 22 more"

    def test_of_many_the_worst_are_shown(self) -> None:
        num = report.MAX_TASKS + 20
        start = np.stack([np.linspace(0.1, 6.0, num), np.ones(num)], axis=1)
        tasks = Task(start, start + np.array([0.1, 1.0]))
        samples = make_samples(20, tasks=tasks)
        ess = np.full(num, 15.0)
        ess[[3, 110]] = 2.0
        summary = make_evidence(None, samples, tasks).summary._replace(effective_sample_size=ess)
        evidence: Evidence = make_evidence(None, samples, tasks, summary=summary)
        demonstrations = [
            Demonstration(f"d{k}", np.repeat(start[k : k + 1], 3, axis=0), Task(*pair))
            for k, pair in enumerate(zip(tasks.start, tasks.goal, strict=True))
        ]
        parsed = Page(page(infer(evidence, demonstrations)))
        names = [row[0] for row in parsed.tables[-1][1:]]
        assert len(names) == report.MAX_TASKS
        assert {"d3", "d110"} <= set(names)
        assert "and 20 more tasks with a larger effective sample size." in parsed.words


class TestWriting:
    def test_creates_the_folder_and_replaces_the_file(self, tmp_path: Path) -> None:
        path = tmp_path / "new folder" / "report.html"
        ordinary().report(path)
        assert path.read_text(encoding="utf-8").endswith("</html>\n")
        write_report(infer(make_evidence()), path)
        assert "no demonstrations yet" in path.read_text(encoding="utf-8")
        assert [item.name for item in path.parent.iterdir()] == ["report.html"]

    def test_a_failure_leaves_the_old_file(self, tmp_path: Path, monkeypatch) -> None:
        path = tmp_path / "report.html"
        path.write_text("old")

        def fail(*_: object, **__: object) -> None:
            raise RuntimeError("no picture")

        monkeypatch.setattr(report.plots, "plot_ranking", fail)
        with pytest.raises(RuntimeError, match="no picture"):
            write_report(ordinary(), path)
        assert path.read_text() == "old"
        assert len(list(tmp_path.iterdir())) == 1

    def test_a_folder_that_cannot_be_is_named(self, tmp_path: Path) -> None:
        (tmp_path / "file").write_text("")
        with pytest.raises(OSError, match=r"cannot write report\.html in .*file"):
            write_report(ordinary(), tmp_path / "file" / "report.html")


class TestSeveral:
    def test_lists_the_picks_in_order(self) -> None:
        result = ordinary()
        picks = greedy(result)
        assert len(picks) > 1
        *_, ranking, several, _ = Page(page(result, picks)).tables
        assert ranking[0][0] == "rank"
        assert several[0][0] == "pick"
        expected = [[f"{n}", f"{p.hypothesis}"] for n, p in enumerate(picks, 1)]
        assert [row[:2] for row in several[1:]] == expected
        assert [float(row[3]) for row in several[1:]] == pytest.approx(
            [pick.total_gain for pick in picks], abs=0.006
        )

    def test_says_why_picking_ended_and_what_would_come_next(self) -> None:
        result = ordinary()
        assert "No constraint was picked." in Page(page(result, [])).words
        assert "Several constraints" not in page(result)
        words = Page(page(result, greedy(result, threshold=100.0))).words
        ended = "no constraint explains 100 nats per demonstration, the threshold; next would be"
        assert f"No constraint was picked. Picking ended: {ended} cell" in words
        words = Page(page(result, greedy(result, most=1))).words
        assert "just before the pick. Picking ended: as many as asked for: 1." in words
