"""Tracks around a planted obstacle, a real one or none; files that cannot be used."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread, imsave
from support.command import Run

from swerve.base.space import Task
from swerve.constraints.occupancy import Occupancy
from swerve.hypotheses.windows import windows
from swerve.inference.posterior import posterior
from swerve.reproduce import files
from swerve.reproduce.human_walk import beta as human_beta
from swerve.reproduce.human_walk import figures as human_walk_figures
from swerve.reproduce.human_walk import measure as human_walk
from swerve.reproduce.human_walk.measure import Result
from swerve.reproduce.human_walk.tracks import read_room, read_tracks
from swerve.solvers.exact.soft_paths import SoftPaths

SIDE, CELL, CORNER = 6.0, 0.05, (-1.0, 2.0)  # m
BETA = 11.0
MIDDLE = (2.25, 4.875)  # of the planted obstacle, one of the hypotheses
OBSTACLE = ((0.21, 0.55), (0.79, 1.01), (1.19, 0.51), (0.61, 0.05))  # m, of the recorded room
HEADER = "t,track,x,y\n"


def write_room(folder: Path) -> None:
    """Write the map of a square room with a wall that reaches into it."""
    size = round(SIDE / CELL)
    free = np.ones((size, size))
    free[:, [0, -1]] = free[[0, -1]] = 0.0
    free[: size // 4, size // 2] = 0.0
    imsave(folder / "room.png", free[::-1], cmap="gray", vmin=0.0, vmax=1.0)
    (folder / "room.json").write_text(json.dumps({"corner": CORNER, "cell": CELL}))


def write_tracks(folder: Path, tracks: Sequence[np.ndarray]) -> None:
    """Write tracks [L, 2] with a sample each 0.3 s."""
    lines = [
        f"{0.3 * k:.2f},{number},{x:.4f},{y:.4f}\n"
        for number, track in enumerate(tracks)
        for k, (x, y) in enumerate(track)
    ]
    (folder / "tracks.csv").write_text(HEADER + "".join(lines))


@cache
def sampled(is_planted: bool, seed: int, num: int = 60) -> list[np.ndarray]:
    """Return tracks from side to side, sampled exactly from pi_c or pi_0."""
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        write_room(Path(name))
        room = read_room(Path(name))
    problem = human_walk.problem_of(room, BETA)
    places = human_walk.squares(problem.hypotheses).reshape(-1, 2, 2).mean(axis=2)
    planted = int(np.linalg.norm(places - MIDDLE, axis=1).argmin())
    np.testing.assert_allclose(places[planted], MIDDLE)
    nominal, generator = SoftPaths().learn(problem), np.random.default_rng(seed)
    tracks = []
    for _ in range(num):
        angle = generator.uniform(-0.9, 0.9) + generator.choice([0.0, np.pi])
        away = 2.2 * np.array([np.cos(angle), np.sin(angle)])
        task = Task(np.array(MIDDLE) - away, np.array(MIDDLE) + away)
        avoiding = [planted] if is_planted else []
        found = nominal.answer(task, generator, avoiding=avoiding).kept
        tracks.append(found.states[0, : found.length[0] + 1])
    return tracks


def folder_of(path: Path, tracks: Sequence[np.ndarray]) -> Path:
    """Return a folder of the room and tracks."""
    write_room(path)
    write_tracks(path, tracks)
    return path


def rows_of(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file."""
    with path.open() as file:
        return list(csv.DictReader(file))


def first_pick(answer: human_walk.Answer) -> np.ndarray:
    """Return the centre of the first pick."""
    return np.array(human_walk.picks_json(answer)[0]["centre"])


@pytest.fixture(scope="module")
def planted(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """The result for tracks around a planted obstacle."""
    folder = folder_of(tmp_path_factory.mktemp("planted"), sampled(True, 0))
    return human_walk.reproduce(folder, is_quick=True)


def test_a_planted_obstacle_is_found(planted: Result) -> None:
    answer = planted.answer
    assert np.linalg.norm(first_pick(answer) - MIDDLE) < 0.3
    assert answer.elsewhere is not None
    ahead = answer.picks[0].total_gain - answer.inference.log_likelihood[answer.elsewhere]
    assert ahead > 5.0
    assert answer.inference.posterior.none < 0.01
    picked = [pick["centre"] for pick in human_walk.picks_json(answer)]
    assert np.abs(np.subtract(picked[1], picked[0])).max() > 0.3  # not its neighbour again
    assert planted.beta.interval[0] < planted.beta.value < planted.beta.interval[1]
    assert 0.8 * BETA < planted.beta.value < 1.25 * BETA


def test_squares_without_floor_are_no_hypotheses() -> None:
    blocked = np.random.default_rng(0).random((24, 40)) < 0.9
    room = Occupancy("walls", blocked, (1.0, -2.0), 0.25)
    places = windows(x=(0.0, 12.0, 0.75), y=(-3.0, 6.0, 0.75), overlap=4)
    prior = human_walk.floor_prior(places, room)
    assert prior[0] == 0.5
    assert prior.sum() == pytest.approx(1.0)
    rows, columns = np.nonzero(~blocked)
    x, y = 1.0 + 0.25 * (columns + 0.5), -2.0 + 0.25 * (rows + 0.5)  # middles of free cells
    found = human_walk.squares(places)
    for index in range(0, len(places), 37):
        x_low, x_high, y_low, y_high = found[index]
        reach = 0.25 / 2 + 1e-9  # a side between two middles is rounded either way
        outer = (x > x_low - reach) & (x < x_high + reach) & (y > y_low - reach)
        inner = (x > x_low + reach) & (x < x_high - reach) & (y > y_low + reach)
        assert prior[1 + index] == 0.0 or (outer & (y < y_high + reach)).any()
        assert prior[1 + index] > 0.0 or not (inner & (y < y_high - reach)).any()
    assert 0.2 < (prior[1:] > 0.0).mean() < 0.8


def test_gains_add_up(planted: Result) -> None:
    answer = planted.answer
    np.testing.assert_allclose(
        answer.gains.sum(axis=1), [pick.total_gain for pick in answer.picks], atol=1e-8
    )
    first = answer.picks[0].hypothesis
    assert answer.inference.log_likelihood[first] == pytest.approx(answer.picks[0].total_gain)
    assert answer.inference.log_likelihood.max() == answer.inference.log_likelihood[first]


def test_belief_moves_with_the_number_of_tracks(planted: Result) -> None:
    belief, inference = planted.belief, planted.answer.inference
    assert belief.sizes[-1] == len(inference.demonstrations)
    np.testing.assert_allclose(belief.none[-1], inference.posterior.none)  # the whole set
    assert belief.gain.mean(axis=1)[-1] == pytest.approx(planted.answer.picks[0].total_gain)
    assert belief.near.mean(axis=1)[0] < 0.1 < 0.9 < belief.near.mean(axis=1)[-1]
    one = inference.contributions[:1].sum(axis=0)
    assert belief.none[0].min() <= posterior(one, inference.prior)[0] <= belief.none[0].max()


def test_without_an_obstacle_nothing_is_sure(tmp_path: Path) -> None:
    result = human_walk.reproduce(folder_of(tmp_path, sampled(False, 1)), is_quick=True)
    assert result.answer.inference.posterior.none > 0.2
    assert all(pick.log_odds < 2.0 for pick in result.answer.picks)


def test_what_is_drawn_is_what_was_measured(planted: Result, tmp_path: Path) -> None:
    written = files.write(
        tmp_path, human_walk_figures.parts(planted), human_walk_figures.tables(planted)
    )
    assert len(written) == 13
    shown = (tmp_path / "human_walk_picks.md").read_text()
    first = human_walk.picks_json(planted.answer)[0]
    assert f"| {planted.beta.value:.2f} | 1 | {first['centre'][0]:.2f} |" in shown
    assert f"| {first['gain_nats']:.1f} ± {first['standard_error']:.1f} |" in shown
    for path in written:
        if path.suffix == ".png":
            assert imread(path).shape[1] == 3.5 * 300
    rows = rows_of(tmp_path / "human_walk_map.csv")
    [first] = [row for row in rows if row["pick"] == "1"]
    assert float(first["log_likelihood_nats"]) == pytest.approx(
        planted.answer.picks[0].total_gain, abs=1e-3
    )
    assert first["num_entering"] == "0"
    assert sum(float(row["posterior"]) for row in rows) == pytest.approx(
        1.0 - planted.answer.inference.posterior.none, abs=1e-2
    )
    rows = rows_of(tmp_path / "human_walk_belief.csv")
    assert [int(row["num_tracks"]) for row in rows] == planted.belief.sizes
    rows = rows_of(tmp_path / "human_walk_sensitivity.csv")
    assert {float(row["beta_per_m"]) for row in rows} == {
        float(f"{answer.beta:.4g}") for answer in planted.sensitivity
    }
    rows = rows_of(tmp_path / "human_walk_beta.csv")
    [chosen] = [row for row in rows if row["is_chosen"] == "1"]
    assert float(chosen["beta_per_m"]) == pytest.approx(planted.beta.value, rel=1e-5)
    text = human_walk_figures.text(planted)
    assert f"beta {planted.beta.value:.3g} per metre" in text
    assert len(text.splitlines()) >= 4 + len(planted.sensitivity) * 2


def test_the_command_prints_json(
    planted: Result, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What --json prints is the result itself, with all of its numbers."""
    monkeypatch.setattr(human_walk, "reproduce", lambda *given, **options: planted)
    words = ("reproduce", "human-walk", "--data", folder_of(tmp_path, []), "--quick")
    printed = [run(*words, *more)[1] for more in (("--json",), ())]
    assert json.loads(printed[0]) == json.loads(json.dumps(human_walk.to_json(planted)))
    assert not printed[1].startswith("{")


@pytest.mark.slow
def test_the_obstacle_of_the_recorded_room(shared_data: Path, run: Run, tmp_path: Path) -> None:
    arguments = ("--data", shared_data / "human_walk", "--quick", "--json", "--out", tmp_path)
    status, printed, said = run("reproduce", "human-walk", *arguments)
    assert status == 0, said
    found: dict[str, Any] = json.loads(printed)
    assert found["num_tracks"] == 70
    picks, apart = found["picks"], found["elsewhere"]
    truth = np.mean(OBSTACLE, axis=0)
    assert np.linalg.norm(np.array(picks[0]["centre"]) - truth) < 0.3
    low, high = np.array(apart["centre"]) - 0.375, np.array(apart["centre"]) + 0.375
    corners = np.array(OBSTACLE)
    assert (corners.max(axis=0) < low).any() or (corners.min(axis=0) > high).any()
    assert picks[0]["gain_nats"] > apart["gain_nats"] + 5.0
    assert np.abs(np.subtract(picks[1]["centre"], picks[0]["centre"])).max() > 0.75
    assert picks[0]["gain_nats"] == pytest.approx(70 * picks[0]["gain_per_track"])
    assert found["probability_none"] < 0.01
    assert found["belief"][-1]["near_first_pick"][0] > 0.9
    assert not found["beta_at_boundary"]
    assert (tmp_path / "human_walk_map.png").exists()


def test_betas_are_tried_until_they_get_worse() -> None:
    tried = human_beta.ladder(7.0, is_quick=False)
    assert tried[0] == pytest.approx(7.0 * 1.02)
    np.testing.assert_allclose(tried[1:] / tried[:-1], 1.05)
    assert 7.0 * 2.8 < tried[-1] <= 7.0 * 3.0


def track(*points: tuple[float, float], num: int = 12) -> np.ndarray:
    """Return a track along straight lines."""
    knots = np.linspace(0.0, len(points) - 1.0, num)
    return np.stack([np.interp(knots, range(len(points)), axis) for axis in np.array(points).T], 1)


STRAIGHT = track((0.0, 6.0), (4.0, 6.5))


def test_which_tracks_are_used(tmp_path: Path) -> None:
    tracks = [
        STRAIGHT,
        STRAIGHT[::-1],
        track((0.0, 6.0), (2.0, 6.0)),
        track((0.0, 6.0), (2.0, 3.8), (2.0, 7.5), (3.5, 6.0), num=40),
        track((0.5, 2.6), (4.2, 2.6)),  # through the wall in the middle
        track((-0.9, 4.0), (-0.9, 7.5)),  # with a shoulder in the wall
    ]
    folder = folder_of(tmp_path, tracks)
    found = read_tracks(folder, read_room(folder))
    assert [item.name for item in found.used] == ["track 0", "track 1"]
    np.testing.assert_allclose(found.used[0].states, STRAIGHT, atol=1e-4)
    assert list(found.left_out.values()) == [1, 1, 2]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,x,y\n0,1,2\n", "tracks.csv: no column track"),
        (
            HEADER + "0,1,2,3\n1,1,2,oops\n",
            r"row 2 \(line 3\), column y: .* got 'oops'",
        ),
        (
            HEADER + "0,1,2,3\n1,1,nan,3\n",
            r"row 2 \(line 3\), column x: .* got nan",
        ),
        (HEADER + "0,1,2,3\n0,1,2,3\n", r"row 2 \(line 3\): t does not increase within track 1"),
        (HEADER, "a header and no rows"),
        (HEADER + "0,1,2,5\n1,1,2,5.1\n", "0 tracks that can be used, expected at least 2"),
        (HEADER + "0,1,20,5\n1,1,50,5\n", "1 of 1 tracks lead through walls or outside room.png"),
    ],
)
def test_tracks_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    write_room(tmp_path)
    (tmp_path / "tracks.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_tracks(tmp_path, read_room(tmp_path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}", "KeyError('corner')"),
        ('{"corner": [0], "cell": 1}', "not enough values"),
        ('{"corner": [0, 1], "cell": 0}', "finite and cell > 0"),
        ('{"corner": [0, 1], "cell": "2_5"}', "finite and cell > 0"),
        (2000 * "[", "room.json: expected"),
        ("metres", "room.json: expected"),
        ('{"corner": [0, 0], "cell": 0.001}', "no floor wide enough for a body"),
    ],
)
def test_a_room_that_lies_nowhere(tmp_path: Path, text: str, message: str) -> None:
    write_room(tmp_path)
    (tmp_path / "room.json").write_text(text)
    with pytest.raises(ValueError, match=re.escape(message)):
        read_room(tmp_path)


def test_pictures_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"room.png: no such file"):
        read_room(tmp_path)
    (tmp_path / "room.png").write_text("walls")
    with pytest.raises(ValueError, match=r"room.png: expected a PNG picture"):
        read_room(tmp_path)
    imsave(tmp_path / "room.png", np.zeros((20, 20)), cmap="gray", vmin=0.0, vmax=1.0)
    with pytest.raises(ValueError, match=r"room.png: all pixels are dark"):
        read_room(tmp_path)


def test_without_a_place_the_room_is_that_of_thor(tmp_path: Path) -> None:
    write_room(tmp_path)
    (tmp_path / "room.json").unlink()
    room = read_room(tmp_path)
    assert (room.picture.corner, room.picture.cell) == ((-11.0, -10.0), 0.01)


def test_the_command_says_what_is_missing(tmp_path: Path, run: Run) -> None:
    for arguments, message in (
        ((), "--data None: expected a folder of tracks.csv and room.png"),
        (("--data", tmp_path / "nowhere"), "nowhere: no such file; check the path"),
        (("--data", tmp_path), "room.png: no such file"),
    ):
        status, _, said = run("reproduce", "human-walk", *arguments)
        assert status == 1
        assert message in said
    status, _, said = run("reproduce", "gridworld")
    assert status == 1
    assert "gridworld: give --out" in said
