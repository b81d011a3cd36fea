"""Posteriors are right as often as they say, on a small gridworld where everything is exact."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from benchmarks import calibration

NUM_DRAWS = 400
SIGMAS = 3.0 / 1.96  # as the intervals are of 95 %


@pytest.fixture(scope="module")
def world() -> calibration.World:
    betas = [scenario.beta for scenario in calibration.SCENARIOS]
    return calibration.make_world("gridworld?width=5&height=5&num_steps=12", 100, betas, seed=0)


def trials(world: calibration.World, name: str) -> dict:
    [scenario] = [one for one in calibration.SCENARIOS if one.name == name]
    generator = np.random.default_rng(1)
    return calibration.summarise(
        [calibration.try_once(world, scenario, generator) for _ in range(NUM_DRAWS)]
    )


@pytest.mark.parametrize("name", ["as assumed", "as assumed, 10 % ignore it"])
def test_credible_sets_contain_the_truth_as_often_as_they_say(
    world: calibration.World, name: str
) -> None:
    found = trials(world, name)
    for said, contained, error in zip(
        found["said"], found["contained"], found["error"], strict=True
    ):
        assert contained == pytest.approx(said, abs=SIGMAS * error)
    assert found["none_was"] == pytest.approx(found["none_said"], abs=3 * 0.5 / NUM_DRAWS**0.5)
    for one in found["none_bins"]:
        spread = (one["said"] * (1 - one["said"]) / one["num"]) ** 0.5
        assert one["was"] == pytest.approx(one["said"], abs=3.5 * max(spread, 1 / one["num"]))
    assert found["truth"] > 0.3


def test_a_tolerance_that_is_needed_and_not_given_shows(world: calibration.World) -> None:
    found = trials(world, "10 % ignore it, none assumed")
    assert found["contained"][2] < found["said"][2] - SIGMAS * found["error"][2]


def test_another_beta_shows_in_the_rewards(world: calibration.World) -> None:
    as_assumed = trials(world, "as assumed")["quantile"]
    assert as_assumed == pytest.approx(0.5, abs=0.05)
    assert trials(world, "beta twice that assumed")["quantile"] > as_assumed + 0.05


def test_prints_and_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(calibration.PROBLEMS, "gridworld", "gridworld?width=4&height=4&num_steps=8")
    figure = tmp_path / "calibration.png"
    given = ["--problem", "gridworld", "--draws", "40", "--figure", str(figure)]
    monkeypatch.setattr("sys.argv", ["calibration.py", *given])
    calibration.main()
    shown = capsys.readouterr().out
    assert all(scenario.name.split(",")[0] in shown for scenario in calibration.SCENARIOS[:1])
    assert imread(figure).std() > 0.05
    monkeypatch.setattr("sys.argv", ["calibration.py", *given, "--json"])
    calibration.main()
    data = json.loads(capsys.readouterr().out)
    assert list(data["gridworld"]) == [scenario.name for scenario in calibration.SCENARIOS]
