"""The car's result on a small scale, and its parts."""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.command import Run

from swerve import Box, Car, Evidence, Inference, Nominal, infer
from swerve.demonstrators.driver import drives
from swerve.evidence.exact import ExactAnswer, KeptTrajectories, exact_evidence
from swerve.fitting.beta import BetaFit
from swerve.reproduce.car import figures as car_figures
from swerve.reproduce.car import kept as car_kept
from swerve.reproduce.car import measure as car
from swerve.reproduce.car.measure import EXACT, NEXT, OBSTACLE, OTHER, TRUTH, verdict
from swerve.solvers.trained.soft_value import SoftValue

SMALL = car.Scale(
    dt=0.25,
    num_drives=8,
    num_trajectories=200,
    solver=SoftValue(num_steps=60_000, num_lanes=64),
    num_paper=20,
    num_rollouts=100,
    num_updates=50,
)


def test_the_true_region_holds_the_middle_of_the_obstacle() -> None:
    problem = car.model(SMALL, 0.4)
    region = problem.hypotheses.constraint(TRUTH)
    middle = [0.5 * sum(OBSTACLE.intervals[name]) for name in ("x", "y")]
    assert region.contains(np.array([*middle, 0.0, 1.0]), problem.mdp.space)
    assert isinstance(region, Box)
    assert region.intervals["x"] == pytest.approx(OBSTACLE.intervals["x"])


def test_verdicts() -> None:
    assert verdict(TRUTH) == EXACT
    assert {verdict(TRUTH + step) for step in (-1, 1, -14)} == {NEXT}
    assert {verdict(TRUTH + step) for step in (-2, 2, -13, -15)} == {OTHER}
    assert verdict(14) == OTHER  # the first of the right lane is not next to the left's last
    assert verdict(13) == OTHER


def test_a_place_that_is_shared_is_nobodys() -> None:
    posterior = np.full(29, 1.0 / 29.0)
    singles = [car.Single(TRUTH, tied, 0, posterior) for tied in (1, 1, 3)]
    singles.append(car.Single(TRUTH + 1, 1, 0, posterior))
    assert list(car_figures.counts(singles).values()) == [2, 1, 0, 1]


def test_when_a_monitor_knows_for_good() -> None:
    y = np.array([0.0, 1.0, 2.0, 3.0])
    assert car._from(y, np.array([True, True, True, True])) == 0.0
    assert car._from(y, np.array([True, False, True, True])) == 2.0
    assert math.isnan(car._from(y, np.array([True, True, True, False])))


def test_what_one_drive_says_and_seven_say() -> None:
    """The evidence is made up: the probability of driving around each region is given."""
    problem = car.model(car.FULL, 0.5)
    avoid = np.r_[np.full(14, 0.999), np.exp(np.linspace(-19.0, -6.0, 14))]
    states = np.array([[[0.0, 0.0, 0.0, 1.0], [0.0, 8.6, 0.0, 1.0]]])
    kept = KeptTrajectories(states, np.zeros(1), np.ones(1, int), np.zeros((1, 4), np.uint8))
    answer = ExactAnswer(0.0, np.log(avoid), kept)
    evidence = exact_evidence(problem.record, car.TASK, answer, "Toy()", 0)
    made = drives(Car(), OBSTACLE, 12)
    for drive in made:
        single = car._single(evidence, drive)
        entered = infer(evidence, [drive]).entered[0]
        left_out = np.flatnonzero(~entered)
        assert single.first == left_out[avoid[left_out].argmin()]
        assert (single.tied, single.bounds) == (1, 0)
        assert single.posterior.sum() == pytest.approx(1.0)
    found = [verdict(car._single(evidence, drive).first) for drive in made]
    assert found.count(EXACT) > 6
    assert found.count(OTHER) <= 1
    # the truth comes first unless all seven drives leave out the region before it too
    entered = infer(evidence, made).entered
    assert not entered[:, TRUTH].any()
    assert car._seven_share(evidence, made, 0) > 0.9


def resolved(nominal: Nominal, inference: Inference, *, keep: Callable, **how: object) -> Evidence:
    """Keep the evidence as it is."""
    keep(inference.evidence)
    return inference.evidence


def test_files_and_resuming(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a hardly trained network, a given beta and nothing resolved."""
    fit = BetaFit(0.45, (0.4, 0.5), 0.01, (0.3, 0.6), 0.95)
    monkeypatch.setattr(car, "QUICK", SMALL)
    monkeypatch.setattr(car, "fit_beta", lambda *arguments: fit)
    monkeypatch.setattr(car_kept, "resolve", resolved)
    monkeypatch.setattr(Inference, "is_open", np.ones((1, 28), bool))
    command = ("reproduce", "car", "--quick", "--out", tmp_path / "out")
    status, printed, said = run(*command)
    assert status == 0, said
    assert "after 7 drives the true region has" in printed
    figures = {
        f"car_{name}.{kind}" for name in ("track", "early") for kind in ("png", "svg", "csv")
    }
    tables = {f"car_{name}.md" for name in ("drives", "facts", "regions", "times")}
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"work", *figures, *tables}
    with (tmp_path / "out" / "car_early.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == SMALL.num_drives
    assert {row["is"] for row in rows} <= {EXACT, NEXT, OTHER}
    assert all(0 <= int(row["bounds"]) <= 28 for row in rows)
    assert all(row["y_near_m"] == "nan" or 0.0 <= float(row["y_near_m"]) < 9.0 for row in rows)
    with (tmp_path / "out" / "car_track.csv").open() as file:
        belief = {row["region"]: float(row["posterior_of_seven"]) for row in csv.DictReader(file)}
    assert sum(belief.values()) == pytest.approx(1.0, abs=1e-3)
    first = (tmp_path / "out" / "car_track.csv").read_bytes()
    folder = tmp_path / "out" / "work" / "car" / "quick.seed0"
    assert {path.name for path in folder.iterdir()} == {
        *("made_by.json", "seconds.json", "first.nominal", "first.evidence", "fitted.nominal"),
        *("fitted.evidence", "resolved.evidence", "foresight", "paper.evidence"),
    }

    def refuse(*arguments: object, **settings: object) -> None:
        raise AssertionError("was done before")

    for name in ("learn", "sample", "foresee"):
        monkeypatch.setattr(car_kept, name, refuse)
    assert run(*command)[0] == 0
    assert (tmp_path / "out" / "car_track.csv").read_bytes() == first
    shutil.copy(folder / "paper.evidence", folder / "resolved.evidence")  # of another beta
    status, _, said = run(*command)
    assert (status, "remove the file" in said) == (1, True), said


def test_drives_that_tell_no_beta(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fit = BetaFit(math.inf, (0.4, math.inf), math.nan, (0.3, 0.6), 0.95)
    monkeypatch.setattr(car, "QUICK", SMALL)
    monkeypatch.setattr(car, "fit_beta", lambda *arguments: fit)
    with pytest.raises(ValueError, match="free track do not determine beta: beta at the boundary"):
        car.reproduce(tmp_path, is_quick=True)
