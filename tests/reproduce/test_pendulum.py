"""The pendulum's result on a small scale: files, kept results, refused input."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from support.command import Run

from swerve.constraints.base import violates
from swerve.reproduce import kept_demonstrations
from swerve.reproduce.double_pendulum import measure as double_pendulum
from swerve.reproduce.keeping import Clock
from swerve.reproduce.pendulum import figures as pendulum_figures
from swerve.reproduce.pendulum import measure as pendulum
from swerve.reproduce.ways import DISCRETE, GRID, SOFT_VALUE, Way, best_tables
from swerve.sampling import sample as sampling
from swerve.systems.pendulum import pendulum as make_pendulum

TABLES = tuple(Way(DISCRETE, f"discrete?num_cells={cells}&hold=10", None) for cells in (12, 20))
SMALL = pendulum.Scale({10.0: (Way(GRID, "grid?num_points=41", "smc"), *TABLES)}, 3, 200)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pendulum, "QUICK", SMALL)


@pytest.fixture
def theirs(tmp_path: Path, shared_data: Path) -> Path:
    """Three of the authors' demonstrations, with their exact probabilities."""
    folder = tmp_path / "theirs"
    folder.mkdir()
    for name in ("demo_002.csv", "demo_006.csv", "demo_009.csv", "tasks.csv"):
        shutil.copy(shared_data / "pendulum" / name, folder)
    for path in (shared_data / "pendulum").glob("exact_*.csv"):
        shutil.copy(path, folder)
    return folder


@pytest.mark.usefixtures("small")
def test_files_and_resuming(
    run: Run, tmp_path: Path, theirs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ("reproduce", "pendulum", "--quick", "--out", tmp_path / "out", "--data", theirs)
    partial = tmp_path / "out" / "work" / "pendulum" / "quick.seed0" / "C1.partial"
    partial.mkdir(parents=True)
    (partial / "demo_000.csv").write_text("cut sh")  # left by an interrupted run
    status, printed, said = run(*command)
    assert status == 0, said
    assert "C2, where it falls; torques to 10" in printed
    written = {path.name for path in (tmp_path / "out").iterdir()}
    names = ("pendulum_rank_torque10", "pendulum_rank_real")
    assert written == {
        "work",
        *(f"{name}.{kind}" for name in names for kind in ("png", "svg", "csv")),
        *(f"pendulum_{name}.md" for name in ("ranks", "nats", "times")),
    }
    with (tmp_path / "out" / "pendulum_rank_torque10.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["demonstrations"] for row in rows} == {"C1", "C2"}
    assert {row["num_demonstrations"] for row in rows} == {"1", "2", "3"}
    for row in rows:
        low, rank, high = (
            float(row[name]) for name in ("interval_low", "average_rank", "interval_high")
        )
        assert 1.0 <= low <= rank <= high
    assert imread(tmp_path / "out" / "pendulum_rank_real.png").shape[1] == 1050
    nats = (tmp_path / "out" / "pendulum_nats.md").read_text()
    assert "exact files" in nats
    first = (tmp_path / "out" / "pendulum_rank_torque10.csv").read_bytes()

    def refuse(*arguments: object, **settings: object) -> None:
        raise AssertionError("was made before")

    monkeypatch.setattr(kept_demonstrations, "first_optima", refuse)
    monkeypatch.setattr("swerve.sampling.sample.sample_each", refuse)
    assert run(*command)[0] == 0
    assert (tmp_path / "out" / "pendulum_rank_torque10.csv").read_bytes() == first


@pytest.mark.usefixtures("small")
def test_an_interrupted_one_goes_on(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def command(out: str) -> tuple:
        return ("reproduce", "pendulum", "--quick", "--out", tmp_path / out)

    assert run(*command("whole"))[0] == 0
    optima, work = (
        kept_demonstrations.first_optima,
        tmp_path / "cut" / "work" / "pendulum" / "quick.seed0",
    )

    def once(*arguments: Any, **settings: Any) -> Any:
        if (work / "C1").exists():
            raise KeyboardInterrupt
        return optima(*arguments, **settings)

    with monkeypatch.context() as patched:
        patched.setattr(kept_demonstrations, "first_optima", once)
        assert run(*command("cut"))[0] != 0
    assert not (work / "C2").exists()
    sampled = sampling.sample_each
    calls = []

    def twice(*arguments: Any, **settings: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return sampled(*arguments, **settings)

    with monkeypatch.context() as patched:
        patched.setattr(sampling, "sample_each", twice)
        assert run(*command("cut"))[0] != 0
    assert not list((tmp_path / "cut").glob("pendulum_*"))
    assert run(*command("cut"))[0] == 0
    for kind in ("rank_torque10.csv", "ranks.md"):
        whole, cut = (tmp_path / out / f"pendulum_{kind}" for out in ("whole", "cut"))
        assert cut.read_bytes() == whole.read_bytes()


@pytest.mark.usefixtures("small")
def test_files_of_another_run_are_named(run: Run, tmp_path: Path) -> None:
    other = tmp_path / "pendulum_rank_real.csv"
    other.write_text("of a run with --data")
    status, _, said = run("reproduce", "pendulum", "--quick", "--out", tmp_path)
    assert status == 0, said
    assert "not of this run: pendulum_rank_real.csv" in said
    assert other.read_text() == "of a run with --data"


@pytest.mark.usefixtures("small")
def test_demonstrations_avoid_their_cells(tmp_path: Path, theirs: Path) -> None:
    result = pendulum.reproduce(tmp_path, theirs, is_quick=True)
    problem = make_pendulum()
    starts = []
    for source in result.sources:
        cell = problem.hypotheses.constraint(source.truth)
        assert len(source.demonstrations) == 3
        for one in source.demonstrations:
            assert not violates(cell, one.states, problem.mdp.space, source.name != "real")
            missed = problem.mdp.space.difference(one.states[-1], one.task.goal)
            assert np.linalg.norm(missed) < 0.06
            starts.append(tuple(one.states[0].round(4).tolist()))
    assert len(set(starts)) == 9
    # of two tables for the same demonstrations, the one of lower average rank is left
    kept = [one for one in result.answers if one.way.name == DISCRETE]
    assert [one.source for one in kept] == ["C1", "C2", "real"]
    worse = kept[0]._replace(curve=kept[0].curve._replace(rank=kept[0].curve.rank + 1.0))
    assert best_tables([worse, kept[0]]) == best_tables([kept[0], worse]) == [kept[0]]
    named = {line.name for panel in pendulum_figures.panels(result) for line in panel.lines}
    assert named & {f"MLCI-Discrete, {cells} cells an axis, 10 steps" for cells in (12, 20)}
    assert set(result.seconds) >= {"C1: demonstrations", "torque 10: grid, sample C1"}
    assert {one.max_torque for one in result.exact} == {10.0}


def test_exact_files_give_the_nats_of_the_method(shared_data: Path) -> None:
    """METHOD, section 5: 13.4, 4.7, 4.3 and 3.1 nats, by all 33 demonstrations."""
    folder = shared_data / "pendulum"
    theirs = pendulum._read(folder, None)
    scale = pendulum.FULL._replace(ways={10.0: ()})
    violation = pendulum._exact_violation(folder, scale, theirs)[10.0]
    exact = pendulum._exact(10.0, violation, theirs, 10_000, 0)
    np.testing.assert_allclose(
        exact.nats[list(pendulum.FOLLOWED)], [13.4, 4.7, 4.3, 3.1], atol=0.06
    )
    # average ranks and shares of first places over 200 subsets; in METHOD over 2,000
    for size, rank, first in ((1, 17.9, 0.03), (3, 9.1, 0.08), (10, 2.2, 0.39), (30, 1.0, 0.99)):
        place = exact.curve.sizes.index(size)
        spread = 0.6 * rank * np.sqrt(1 / 200 + 1 / 2_000)  # of ranks, nearly exponential
        assert exact.curve.rank[place] == pytest.approx(rank, abs=3.0 * spread)
        noise = np.sqrt(first * (1.0 - first) * (1 / 200 + 1 / 2_000))
        assert exact.curve.first[place] == pytest.approx(first, abs=3.0 * noise + 0.005)


def test_exact_files_are_checked(theirs: Path) -> None:
    path = theirs / "exact_violation_torque10.csv"
    made_by = pendulum._read(theirs, None).demonstrations
    rows = path.read_text().splitlines()
    for kept, message in (
        ([row for row in rows if not row.startswith("006")], "expected a row 006 .*got none"),
        ([row.rpartition(",")[0] for row in rows], "a probability for each of the 100 cells"),
        ([row.replace("0.", "3.") for row in rows], "a probability for each"),
    ):
        path.write_text("\n".join(kept))
        with pytest.raises(ValueError, match=message):
            pendulum.read_violation(path, made_by)


def test_another_seed_makes_others_and_another_number_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        pendulum, "QUICK", SMALL._replace(ways={10.0: TABLES[:1]}, num_demonstrations=1)
    )
    first, second = (pendulum.reproduce(tmp_path, is_quick=True, seed=seed) for seed in (0, 1))
    starts = [one.sources[0].demonstrations[0].states[0] for one in (first, second)]
    assert not np.allclose(*starts)
    seconds = pendulum.reproduce(tmp_path, is_quick=True).seconds
    assert seconds == first.seconds  # a loaded result takes no time
    monkeypatch.setattr(pendulum, "QUICK", SMALL)
    with pytest.raises(ValueError, match="with other settings: remove the folder"):
        pendulum.reproduce(tmp_path, is_quick=True)


@pytest.mark.usefixtures("small")
def test_what_is_refused(run: Run, tmp_path: Path, theirs: Path) -> None:
    command = ("reproduce", "pendulum", "--quick", "--out", tmp_path / "out")
    (tmp_path / "empty").mkdir()
    for data, message in (
        (tmp_path / "none", "no such file"),
        (tmp_path / "empty", "expected demo_*.csv and tasks.csv, found none"),
    ):
        status, _, said = run(*command, "--data", data)
        assert (status, message in said) == (1, True), said
    path = theirs / "demo_002.csv"
    text = path.read_text().splitlines()
    time = text[40].split(",")[0]
    text[40] = f"{time},3.4,0.5,0.0"
    path.write_text("\n".join(text))
    status, _, said = run(*command, "--data", theirs)
    assert status == 1
    assert "demo_002" in said
    for name in ("car", "double-pendulum"):
        status, _, said = run("reproduce", name, "--out", tmp_path / "x", "--data", theirs)
        assert status == 1
        assert "leave --data out" in said
    for arguments in (("--json", "--out", tmp_path / "x"), ()):
        status, _, said = run("reproduce", "pendulum", *arguments)
        assert status == 1
        assert "pendulum: give --out" in said


def test_the_double_pendulum(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ways = (
        Way(SOFT_VALUE, "soft-value?num_steps=20000", "smc"),
        Way(DISCRETE, "discrete?num_cells=6&hold=10", None),
    )
    monkeypatch.setattr(double_pendulum, "QUICK", double_pendulum.Scale(2, 200, ways))
    status, printed, said = run(
        "reproduce", "double-pendulum", "--quick", "--out", tmp_path / "out"
    )
    assert status == 0, said
    assert "soft value + SMC" in printed
    names = {path.name for path in (tmp_path / "out").iterdir()}
    for name in (
        "double_pendulum_rank.csv",
        "double_pendulum_time.png",
        "double_pendulum_ranks.md",
    ):
        assert name in names
    with (tmp_path / "out" / "double_pendulum_rank.csv").open() as file:
        assert {row["way"] for row in csv.DictReader(file)} == {
            "soft value + SMC",
            "MLCI-Discrete, 6 cells an axis, 10 steps",
        }
    with (tmp_path / "out" / "double_pendulum_time.csv").open() as file:
        rows = list(csv.DictReader(file))
    kept = tmp_path / "out" / "work" / "double-pendulum" / "quick.seed0"
    clock = Clock(kept / "seconds.json").seconds
    for way, label in zip(ways, dict.fromkeys(row["way"] for row in rows), strict=True):
        learn = clock[f"double pendulum: {way.label}, learn"]
        sample = clock[f"double pendulum: {way.label}, sample {double_pendulum.NAME}"]
        told = [float(row["wall_time_s"]) for row in rows if row["way"] == label]
        assert told == pytest.approx([learn + 0.5 * sample, learn + sample], rel=1e-3)
