"""The gridworld of the paper: picks, figures and files."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.image import imread
from matplotlib.patches import Rectangle
from support.command import Run
from support.golden_world import left_after

from swerve.answer import infer
from swerve.base.space import Actions, Task
from swerve.inference.greedy import greedy
from swerve.reproduce import files
from swerve.reproduce.gridworld import figures as gridworld_figures
from swerve.reproduce.gridworld import golden as golden_output
from swerve.reproduce.gridworld import measure as gridworld
from swerve.reproduce.gridworld.golden import Golden, Picked
from swerve.sampling.sample import sample
from swerve.solvers.exact.tabular import Tabular
from swerve.systems.gridworld import MOVES, Gridworld


@cache
def own_world() -> Golden:
    """Return the project's own world, whose demonstrations take a while to sample."""
    return gridworld.own_world()


def test_cutting_a_sequence_is_picking_with_the_larger_threshold() -> None:
    world = own_world()
    nominal = Tabular().learn(world.problem)
    for size in (1, 10):
        used = world.sets[0][:size]
        longest = golden_output.pick(nominal, used, 0.01)
        inference = infer(sample(nominal, world.task), used)
        lengths = []
        for threshold in gridworld.THRESHOLDS:
            picks = greedy(inference, nominal, threshold=threshold)
            found = gridworld.cut(longest, threshold)
            assert found.hypotheses == [pick.hypothesis for pick in picks]
            assert found.gains == [pick.gain for pick in picks]
            after = left_after(world.problem, used, picks)
            np.testing.assert_allclose(found.kl[1:], after, atol=1e-12)
            assert found.kl[0] - found.kl[-1] == pytest.approx(sum(found.gains))
            lengths.append(len(picks))
        assert 0 < lengths[0] < lengths[1] < lengths[2]


def test_a_cut_ends_at_the_first_small_gain() -> None:
    picked = Picked([7, 8, 9], [2.0, 0.5, 3.0], [6.0, 4.0, 3.5, 0.5])
    assert gridworld.cut(picked, 0.5) == picked
    assert gridworld.cut(picked, 1.0) == Picked([7], [2.0], [6.0, 4.0])
    assert gridworld.cut(picked, 4.0) == Picked([], [], [6.0])


def test_false_positives_are_picks_that_are_not_true() -> None:
    world = own_world()._replace(truth=frozenset({3, 5}), sizes=[1, 2])
    picked = [
        [Picked([3, 4, 5], [9.0] * 3, [4.0, 3.0, 2.0, 1.0]), Picked([], [], [4.0])],
        [Picked([6, 7], [9.0] * 2, [5.0, 4.0, 3.0]), Picked([5], [9.0], [2.0, 1.5])],
    ]
    found = gridworld.curves([picked], world, [0.1])
    assert found.num_picks.tolist() == [[[3, 0], [2, 1]]]
    assert found.num_false.tolist() == [[[1, 0], [2, 0]]]
    assert found.false_rate.tolist() == [[[1 / 3, 0.0], [1.0, 0.0]]]
    assert found.kl.tolist() == [[[1.0, 4.0], [3.0, 1.5]]]


def test_own_demonstrations_are_drawn_from_the_constrained_distribution() -> None:
    world = gridworld.own_world(seed=3)
    nominal = Tabular().learn(world.problem)
    start = np.random.default_rng(0)
    exact = 1.0 - nominal.answer(world.task, start, avoiding=sorted(world.truth)).avoid_probability
    every = [demonstration for one in world.sets for demonstration in one]
    evidence = sample(nominal, Task(*(end[None] for end in world.task)))
    entered = infer(evidence, every).entered
    assert entered.shape == (500, len(world.problem.hypotheses))
    assert not entered[:, sorted(world.truth)].any()
    error = np.sqrt(exact * (1.0 - exact) / len(every))
    telling = error > 0.005  # shares close to 0 or 1 are not normally distributed
    assert telling.sum() > 15
    assert (np.abs(entered.mean(axis=0) - exact) <= 4.5 * error)[telling].all()
    nominal_violation = evidence.violation_probability[0]
    assert (np.abs(nominal_violation - exact) > 4.5 * error)[telling].sum() > 5
    firsts = {one[0].states.tobytes() for one in world.sets}
    assert len(firsts) > 1
    again = gridworld.own_world(seed=3).sets[4][99]
    np.testing.assert_array_equal(again.states, every[-1].states)


def test_labels_name_the_hypotheses() -> None:
    problem = own_world().problem
    assert isinstance(problem.mdp, Gridworld)
    names, cells = gridworld.labels(problem.mdp), problem.mdp.states
    assert len(names) == len(problem.hypotheses)
    for name, expected in (
        ("cell (6, 3)", [[6, 3]]),
        ("feature A", [[5, 0], [5, 1], [5, 2]]),
        ("move up-left", []),
    ):
        constraint = problem.hypotheses.constraint(names.index(name))
        assert cells[constraint.contains(cells, problem.mdp.space)].tolist() == expected
    move = problem.hypotheses.constraint(names.index("move up-left"))
    forbidden = move.forbids(Actions(("dx", "dy"), np.array(list(MOVES.values()), float)))
    assert forbidden.tolist() == [name == "up-left" for name in MOVES]


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_files_hold_what_the_figures_show(golden: Path, tmp_path: Path) -> None:
    result = gridworld.reproduce(golden)
    written = files.write(
        tmp_path / "out", gridworld_figures.parts(result), gridworld_figures.tables(result)
    )
    assert {path.name for path in written} == {
        "gridworld_means.md",
        *(
            f"gridworld_{figure}.{suffix}"
            for figure in ("curves", "violations")
            for suffix in ("csv", "png", "svg")
        ),
    }
    shown = (tmp_path / "out" / "gridworld_means.md").read_text()
    picks, kl = result.curves.num_picks[0, :, 0].mean(), result.curves.kl[0, :, 0].mean()
    assert f"| {result.curves.sizes[0]} | " in shown
    assert f" / {picks:.1f}, {kl:.3f} |" in shown
    assert sorted(written) == sorted((tmp_path / "out").iterdir())
    for path in written:
        if path.suffix == ".png":
            assert imread(path).std() > 0.05
        elif path.suffix == ".svg":
            assert path.read_text().rstrip().endswith("</svg>")
    rows = read_csv(tmp_path / "out" / "gridworld_curves.csv")
    upper, lower = gridworld_figures.draw_curves(result).axes
    assert len(upper.lines) == 5  # thresholds of [SS] and of the file, and the golden output
    place = 0
    for rate, kl in zip(upper.lines, lower.lines, strict=True):
        some, place = rows[place : place + 3], place + 3
        assert [int(row["num_demonstrations"]) for row in some] == np.asarray(
            rate.get_xdata()
        ).tolist()
        assert [float(row["false_positive_rate"]) for row in some] == np.asarray(
            rate.get_ydata()
        ).tolist()
        assert [float(row["kl_nats"]) for row in some] == np.asarray(kl.get_ydata()).tolist()
        assert f"{float(some[0]['threshold_nats']):g} nat" in str(rate.get_label())
        assert some[0]["source"] == ("golden" if "golden" in str(rate.get_label()) else "swerve")
    assert place == len(rows)


def test_violations_in_file_and_figure(golden: Path) -> None:
    result = gridworld.reproduce(golden)
    rows = gridworld_figures.violation_rows(result)[1:]
    value = {name: float(probability) for _, name, probability, _ in rows}
    true = {name for _, name, _, is_true in rows if is_true == "1"}
    assert true == {"feature 2", "cell (2, 1)", "move down-right"}
    assert value["cell (0, 0)"] == pytest.approx(1.0)
    assert 0.05 < value["cell (1, 1)"] < value["feature 2"] < 1.0
    cells, bars, _ = gridworld_figures.draw_violations(result).axes
    mesh = next(item for item in cells.collections if isinstance(item, QuadMesh))
    shaded = np.asarray(mesh.get_array()).reshape(3, 4)
    assert shaded[1, 2] == value["cell (2, 1)"]
    assert shaded[2, 0] == value["cell (0, 2)"]
    widths = [bar.get_width() for bar in bars.patches if isinstance(bar, Rectangle)]
    named = [label.get_text().split(" ")[0] for label in bars.get_yticklabels()]
    assert widths[named.index("down-right")] == value["move down-right"]
    texts = [*cells.texts, *bars.texts, *bars.get_yticklabels(), *cells.get_xticklabels()]
    assert min(float(text.get_fontsize()) for text in texts) >= 7.0


def test_means_and_standard_errors() -> None:
    mean, error = gridworld_figures.mean_and_error(np.array([[1.0, 2.0], [3.0, 2.0], [5.0, 2.0]]))
    np.testing.assert_allclose(mean, [3.0, 2.0])
    np.testing.assert_allclose(error, [2.0 / np.sqrt(3.0), 0.0])
    assert gridworld_figures.mean_and_error(np.ones((1, 2)))[1].tolist() == [0.0, 0.0]


def test_command(run: Run, golden: Path, tmp_path: Path) -> None:
    out = tmp_path / "made" / "here"
    arguments = ("--out", out, "--data", golden, "--quick")
    status, printed, said = run("reproduce", "gridworld", *arguments)
    assert status == 0, said
    assert "2 of 2 sequences of picks are the golden ones" in printed
    assert [line.split()[0] for line in printed.splitlines()[2:4]] == ["1", "3"]
    assert "gridworld_curves.png" in said
    assert len(read_csv(out / "gridworld_curves.csv")) == 10


def test_without_golden_output() -> None:
    world = gridworld.at_sizes(own_world(), [1, 5])
    world = world._replace(sets=world.sets[:2])
    result = gridworld.measure(world)
    assert result.golden is None
    assert result.agreement is None
    text = gridworld_figures.text(result)
    assert "golden" not in text
    assert len(gridworld_figures.curve_rows(result)) == 1 + 3 * 2
    fewer = result.curves.num_false.mean(axis=1)
    assert (np.diff(fewer, axis=0) >= 0).all()  # a smaller threshold picks more
    assert (np.diff(result.curves.kl, axis=0) <= 0).all()
