"""`swerve infer`: answers, and what it says of bad input."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from support.command import CONSTRAINT, SOLVER, Run, infer


def test_from_demonstrations_to_a_ranking(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    report = tmp_path / "report.html"
    arguments = infer(robot, demonstrations, tmp_path / "work", "--solver", SOLVER, "--json")
    status, out, _ = run(*arguments, "--report", report)
    assert status == 0
    answer = json.loads(out)
    ranking = answer["ranking"]
    assert CONSTRAINT in [entry["index"] for entry in ranking]
    assert {"index", "name", "log_likelihood", "standard_error"} <= set(ranking[0])
    nats = [entry["log_likelihood"] for entry in ranking]
    assert nats == sorted(nats, reverse=True)
    assert len(answer["diagnostics"]) == 4
    assert all(d["effective_sample_size"] > 250 for d in answer["diagnostics"])
    assert "<html" in report.read_text()
    status, out, _ = run(*arguments[:-1])
    assert status == 0
    assert ranking[0]["name"] in out
    assert "uniform measure" in out


def test_several_constraints_one_after_another(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    """The first pick is the first of the ranking; the next gains less than it has alone."""
    common = ("--solver", SOLVER, "--threshold", 0.1, "--greedy", 2)
    arguments = infer(robot, demonstrations, tmp_path / "work", *common)
    status, out, _ = run(*arguments, "--json")
    assert status == 0
    answer = json.loads(out)
    first, second = answer["greedy"]
    best = answer["ranking"][0]
    assert (first["index"], first["name"]) == (best["index"], best["name"])
    assert first["total_gain"] == pytest.approx(best["log_likelihood"])
    assert first["gain"] == pytest.approx(first["total_gain"] / 4)
    assert first["log_odds"] == pytest.approx(answer["none"]["log_bayes_factor"])
    assert second["standard_error"] > 0.0
    size = answer["greedy_ended"].pop("effective_samples")
    assert 1.0 < size <= 500.0
    assert answer["greedy_ended"] == {"why": "most", "threshold": 0.1, "next": None}
    status, out, _ = run(*arguments)
    assert status == 0
    assert "pick  index      nats per demo     +-  log odds  hypothesis" in out
    assert f"    2 {second['index']:>6}  {second['total_gain']:>8.2f}" in out
    assert "as many as asked for: 2" in out


def test_picking_ends_with_a_word_on_how_to_go_on(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    """Picks agree with the posterior beside them; a threshold picks what would come next."""
    work = tmp_path / "work"
    arguments = infer(robot, demonstrations, work, "--solver", SOLVER, "--greedy", 40)
    for none in (0.5, 0.05):
        status, out, _ = run(*arguments, "--prior-none", none, "--json")
        assert status == 0
        answer = json.loads(out)
        assert bool(answer["greedy"]) == (answer["none"]["posterior"] <= 0.5)
        ended = answer["greedy_ended"]
        assert (ended["why"] == "odds") == (ended["next"] is not None)
        assert ended["next"] is None or ended["next"]["log_odds"] < 0.0
    assert answer["greedy"]
    following = (
        r"; next would be cell \d+: .*, for [\d.]+ nats, [\d.]+ per demonstration, at log odds "
        r"-?[\d.]+ \(--threshold ([\d.]+) picks it\)"
    )
    status, out, _ = run(*arguments, "--prior-none", 0.99)
    ended = "nothing picked: one constraint, whichever it is, is less probable than none"
    picks = 0
    for _ in range(2):
        found = re.search(ended + following, out)
        assert found
        status, out, _ = run(*arguments, "--threshold", found[1], "--json")
        answer = json.loads(out)
        assert len(answer["greedy"]) > picks
        picks = len(answer["greedy"])
        assert min(pick["gain"] for pick in answer["greedy"]) >= float(found[1])
        assert answer["greedy_ended"]["next"]["gain"] < float(found[1])
        status, out, _ = run(*arguments, "--threshold", found[1])
        ended = f"no other constraint explains {found[1]} nats per demonstration, the threshold"
    for more, message in (
        (("--greedy", 0, demonstrations[0]), "--greedy: expected a number of picks >= 1, got 0"),
        (("--greedy", 2), "--greedy: constraints are picked from demonstrations"),
        (
            ("--greedy", 2, "--threshold", -0.5, demonstrations[0]),
            "threshold: expected a number >= 0 (nats a demonstration), got -0.5",
        ),
        (
            ("--threshold", 0.5, demonstrations[0]),
            "--threshold: it tells when --greedy ends: give --greedy as well",
        ),
    ):
        status, _, said = run("infer", robot, *more)
        assert status == 1
        assert message in said


def test_exact_answers_are_worked_out_anew_for_each_pick(run: Run, tmp_path: Path) -> None:
    rows = ["x,y,dx,dy", "0,0,0,1", "0,1,1,1", "1,2,1,0", "2,2,1,-1", "3,1,0,-1", "3,0,0,0"]
    (tmp_path / "round.csv").write_text("\n".join(rows))
    problem = "gridworld?width=4&height=3&num_steps=6"
    more = ("--greedy", 3, "--threshold", 0.1, "--json")
    status, out, _ = run("infer", problem, tmp_path / "round.csv", *more)
    assert status == 0
    picks = json.loads(out)["greedy"]
    assert len(picks) == 3
    assert [pick["standard_error"] for pick in picks] == [0.0] * 3


def test_nothing_is_said_to_go_on_without_a_work_folder(
    robot: str, run: Run, demonstrations: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments, **settings):
        raise KeyboardInterrupt

    monkeypatch.setattr("swerve.sampling.sample.sample_each", interrupted)
    status, _, said = run("infer", robot, demonstrations[0], "--solver", SOLVER)
    assert status == 130
    assert said.endswith("interrupted\n")


def test_without_demonstrations_the_ranking_is_the_prior_one(
    robot: str, run: Run, demonstrations: list[Path], tmp_path: Path
) -> None:
    tasks = demonstrations[0].parent / "tasks.csv"
    common = ("--solver", SOLVER, "--samples", 500, "--work", tmp_path / "work", "--json")
    status, out, _ = run("infer", robot, "--tasks", tasks, *common)
    assert status == 0
    answer = json.loads(out)
    assert answer["num_demonstrations"] == 0
    assert len(answer["ranking"]) == 30
    violated = [entry["average_violation"] for entry in answer["ranking"]]
    assert violated[0] > 0.5
    status, out, _ = run("infer", robot, *common)
    assert status == 0
    assert len(json.loads(out)["diagnostics"]) == 4


def test_works_without_a_work_folder(robot: str, run: Run, demonstrations: list[Path]) -> None:
    status, out, _ = run("infer", robot, demonstrations[0], "--solver", SOLVER, "--samples", 200)
    assert status == 0
    assert "hypothesis" in out


class TestBadInput:
    def test_missing_column(self, run: Run, tmp_path: Path) -> None:
        (tmp_path / "x.csv").write_text("t,theta\n0,1\n1,2\n")
        status, _, said = run("infer", "pendulum", tmp_path / "x.csv")
        assert status == 1
        assert "no column omega" in said

    def test_empty_file(self, run: Run, tmp_path: Path) -> None:
        (tmp_path / "x.csv").write_text("")
        status, _, said = run("infer", "pendulum", tmp_path / "x.csv")
        assert status == 1
        assert "x.csv: the file is empty" in said

    def test_nan(self, run: Run, tmp_path: Path) -> None:
        rows = [f"{0.1 * k},1,{'nan' if k == 16 else 0}" for k in range(30)]
        (tmp_path / "x.csv").write_text("t,theta,omega\n" + "\n".join(rows))
        status, _, said = run("infer", "pendulum", tmp_path / "x.csv")
        assert status == 1
        assert "row 17" in said
        assert "omega" in said

    @pytest.mark.parametrize(
        ("task", "message"),
        [
            ("1,0,1,55", "goal omega = 55 is outside the bounds"),
            (
                "2,0,1,0",
                "first state is theta = 1, omega = 0, but the task starts at theta = 2",
            ),
        ],
        ids=["goal outside", "starts elsewhere"],
    )
    def test_a_task_that_does_not_fit(
        self, run: Run, tmp_path: Path, task: str, message: str
    ) -> None:
        (tmp_path / "x.csv").write_text("theta,omega\n1,0\n1,0.1\n")
        tasks = tmp_path / "tasks.csv"
        tasks.write_text(f"demo,start_theta,start_omega,goal_theta,goal_omega\nx,{task}\n")
        status, _, said = run("infer", "pendulum", tmp_path / "x.csv", "--tasks", tasks)
        assert status == 1
        assert message in said

    def test_enters_every_hypothesis(self, robot: str, run: Run, tmp_path: Path) -> None:
        omega = np.linspace(-3.9, 3.9, 5)
        theta = np.linspace(0.0, 6.2, 60)
        rows = [f"{angle},{speed}" for speed in omega for angle in (*theta, *theta[::-1])]
        (tmp_path / "x.csv").write_text("theta,omega\n" + "\n".join(rows))
        status, out, said = run(
            "infer", robot, tmp_path / "x.csv", "--solver", SOLVER, "--samples", 100
        )
        assert status == 0
        assert "no hypothesis is left" in said
        assert "x alone enters 30" in said
        assert "No hypothesis is left" in out

    def test_unknown_problem(self, run: Run) -> None:
        status, _, said = run("infer", "pendulun")
        assert status == 1
        assert "expected one of car" in said

    def test_unknown_parameter(self, run: Run) -> None:
        status, _, said = run("infer", "pendulum?torque=3")
        assert status == 1
        assert "no parameter 'torque'; there are max_torque" in said

    @pytest.mark.parametrize(
        ("option", "value", "message"),
        [
            ("--score", "best", "best"),
            ("--method", "magic", "method: expected one of smc, importance, plain, got 'magic'"),
            ("--samples", 0, "samples: expected a whole number from 2 to 10,000,000, got 0"),
            ("--seed", -1, "seed: expected a whole number from 0 to 4,294,967,295, got -1"),
            ("--solver", "grid?num_points", "expected name=value after '?'"),
            ("--report", ".", "is a folder; name a file"),
            ("--report", "/proc/none/x.html", "error: cannot write in /proc/none"),
            ("--work", __file__, f"error: cannot write in {__file__}: {__file__} is a file, no f"),
            ("--resolve-seconds", "nan", "Invalid value for --resolve-seconds: expected a decimal"),
        ],
    )
    def test_options_are_refused_before_the_work(
        self, robot: str, run: Run, option: str, value: object, message: str
    ) -> None:
        status, out, said = run("infer", robot, option, value)
        assert status in (1, 2)
        assert message in out + said
        assert "learning" not in said

    def test_unknown_solver(self, robot: str, run: Run) -> None:
        status, _, said = run("infer", robot, "--solver", "magic")
        assert status == 1
        assert "no solver named 'magic'; there are grid, ppo" in said
