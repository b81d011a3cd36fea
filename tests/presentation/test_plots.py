from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection, QuadMesh
from matplotlib.colors import to_hex, to_rgba
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import PathPatch
from matplotlib.text import Annotation
from support.synthetic import (
    SPACE,
    TASKS,
    evidence_of_columns,
    make_demonstration,
    make_evidence,
    make_record,
    make_samples,
)

from swerve import Gridworld, Problem, learn, sample, windows
from swerve.base import phrases
from swerve.base.space import TWO_PI, Task
from swerve.constraints import polygons
from swerve.constraints.base import Predicate
from swerve.constraints.boxes import ActionBox, Box
from swerve.constraints.shapes import Ball, HalfSpace
from swerve.constraints.state_action import StateAction
from swerve.demonstrations.demonstration import Demonstration
from swerve.hypotheses.base import ConstraintHypotheses, HypothesisSet, constraint_from_json
from swerve.hypotheses.grid import grid
from swerve.inference.ranking import Inference, infer
from swerve.presentation import plane_picture as picture
from swerve.presentation import plots, shading
from swerve.presentation.plane import plane_of
from swerve.presentation.plots import plot_inference, plot_posterior, plot_ranking

CELLS = grid(theta=(0.0, TWO_PI, 4), x=(0.0, 9.0, 3))


def crossing(name: str = "crossing") -> Demonstration:
    """A demonstration of task 2 that goes through theta = 2 pi, unwrapped."""
    theta = 6.0 + 0.1 * np.arange(12)
    states = np.stack([theta, np.linspace(9.0, 2.0, 12)], axis=1)
    return Demonstration(name, states, Task(TASKS.start[2], TASKS.goal[2]), np.arange(12) * 0.1)


def inference_of(
    hypotheses: HypothesisSet = CELLS, *demonstrations: Demonstration, score: str = "likelihood"
) -> Inference:
    """Later hypotheses are entered more often."""
    evidence = make_evidence(make_record(hypotheses=hypotheses))
    return infer(evidence, demonstrations or (make_demonstration(0), crossing()), score=score)


def axes_of(figure: Figure) -> Axes:
    return figure.axes[0]


def patches(axes: Axes, label: str) -> list[PathPatch]:
    found = [patch for patch in axes.patches if str(patch.get_label()).startswith(label)]
    assert all(isinstance(patch, PathPatch) for patch in found)
    return found  # pyright: ignore[reportReturnType]


def extents(patch: PathPatch) -> np.ndarray:
    return patch.get_path().get_extents().get_points().T.ravel()


def sides(box: Box) -> list[float]:
    return [side for interval in box.intervals.values() for side in interval]


def texts(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in figure.texts)


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


class TestHypotheses:
    def test_the_best_is_outlined_and_annotated_with_index_and_nats(self) -> None:
        result = inference_of()
        best = int(result.ranking[0])
        axes = axes_of(plot_inference(result))
        (outline,) = patches(axes, "ranked first")
        np.testing.assert_allclose(extents(outline), sides(CELLS.constraint(best)))
        (note,) = [text for text in axes.texts if isinstance(text, Annotation)]
        assert note.get_text().startswith(f"cell {best}\n{result.log_likelihood[best]:.1f}"[:-2])
        assert note.get_text().endswith(" nats")

    def test_ties_are_outlined_too(self) -> None:
        columns = np.zeros((1, 400, 12), bool)
        columns[0, :200, [4, 7, 9]] = True
        result = infer(evidence_of_columns(columns, CELLS), [make_demonstration(0)])
        figure = plot_inference(result)
        first = patches(axes_of(figure), "ranked first")
        tied = patches(axes_of(figure), "tied with it")
        found = [extents(patch) for patch in first + tied]
        np.testing.assert_allclose(found, [sides(CELLS.constraint(k)) for k in (4, 7, 9)])
        assert legend(figure).count("tied with it") == 1

    def test_colours_are_the_scores_of_what_is_left(self) -> None:
        result = inference_of()
        (mesh,) = [c for c in axes_of(plot_inference(result)).collections if type(c) is QuadMesh]
        shown = np.ma.masked_array(mesh.get_array())
        expected = result.log_likelihood.reshape(CELLS.shape).T
        np.testing.assert_array_equal(np.ma.getmaskarray(shown), np.isneginf(expected))
        np.testing.assert_array_equal(shown.compressed(), expected[np.isfinite(expected)])
        assert mesh.norm.vmin == 0
        assert mesh.norm.vmax == result.log_likelihood.max()

    def test_what_is_struck_out_is_hatched_and_explained(self) -> None:
        result = inference_of()
        figure = plot_inference(result)
        (hatched,) = patches(axes_of(figure), "struck out")
        assert hatched.get_hatch()
        for index in range(len(CELLS)):
            low, high, bottom, top = sides(CELLS.constraint(index))
            inside = hatched.get_path().contains_point(((low + high) / 2, (bottom + top) / 2))
            assert inside == result.struck_out[index]
        assert f"struck out by a demonstration ({result.struck_out.sum()})" in legend(figure)

    def test_a_grid_over_more_states_shows_the_best_along_the_rest(self) -> None:
        deep = grid(x=(0.0, 9.0, 3), theta=(0.0, TWO_PI, 4), omega=(-1.0, 1.0, 2))
        space = type(SPACE)(
            ("theta", "x", "omega"), ("theta",), np.vstack([SPACE.bounds, [[-1.0, 1.0]]])
        )
        tasks = Task(np.pad(TASKS.start, ((0, 0), (0, 1))), np.pad(TASKS.goal, ((0, 0), (0, 1))))
        samples = make_samples(num_hypotheses=24)
        samples = samples._replace(kept=np.zeros((3, 2, 6, 3)))
        record = make_record(hypotheses=deep, space=space, goal_names=("theta", "x", "omega"))
        states = np.array([[0.1, 1.0, 0.0], [0.2, 1.0, -0.5]])
        walk = Demonstration("walk", states, Task(tasks.start[0], tasks.goal[0]))
        result = infer(make_evidence(record, samples, tasks), [walk])
        axes = axes_of(plot_inference(result))
        (mesh,) = [c for c in axes.collections if type(c) is QuadMesh]
        best = result.log_likelihood.reshape(3, 4, 2).max(axis=2)
        np.testing.assert_array_equal(np.ma.masked_array(mesh.get_array()).filled(-np.inf), best.T)
        assert "best of its cells along omega" in axes.get_title("left")

    def test_boxes_are_drawn_the_best_on_top(self) -> None:
        boxes = [Box(theta=(k, k + 2.0), x=(3.0, 6.0 + k)) for k in range(3)]
        result = inference_of(ConstraintHypotheses(boxes))
        axes = axes_of(plot_inference(result))
        (shades,) = [c for c in axes.collections if type(c) is PolyCollection]
        scores = np.asarray(shades.get_array())
        assert (np.diff(scores) >= 0).all()
        np.testing.assert_array_equal(scores, np.sort(result.log_likelihood[result.ranking]))
        np.testing.assert_allclose(
            shades.get_paths()[-1].get_extents().get_points().T.ravel(),
            sides(boxes[result.ranking[0]]),
        )

    def test_predicates_are_shaded_and_their_names_are_not_mathematics(self) -> None:
        odd = Predicate("half $x_{", lambda s: s[..., 1] > 9.5)
        figure = plot_inference(inference_of(ConstraintHypotheses([odd])))
        (outline,) = patches(axes_of(figure), "ranked first")
        np.testing.assert_allclose(extents(outline)[2:], [9.5, 10.0], atol=0.05)
        assert "half $x_{" in texts(figure)
        figure.draw_without_rendering()

    def test_what_the_plane_cannot_show_is_counted(self) -> None:
        lost = constraint_from_json({"kind": "predicate", "name": "lost", "num_points": 8})
        boxes = [Box(theta=(1.0, 2.0), x=(3.0, 4.0)), lost, Box(x=(20.0, 21.0))]
        evidence = make_evidence(make_record(hypotheses=ConstraintHypotheses(boxes)))
        axes = axes_of(plot_inference(infer(evidence)))
        assert "Not drawn: 2 hypotheses" in axes.get_title("left")

    def test_known_constraints_are_drawn(self) -> None:
        known = (Box(x=(50.0, 60.0)), Box(x=(4.0, 4.5)))
        result = infer(make_evidence(make_record(known=known)), [make_demonstration(0), crossing()])
        figure = plot_inference(result)
        (wall,) = patches(axes_of(figure), "known constraint")
        np.testing.assert_allclose(extents(wall), [0.0, TWO_PI, 4.0, 4.5])
        assert "known constraint" in legend(figure)

    def test_walls_of_a_gridworld_are_drawn(self) -> None:
        world = Gridworld(width=4, height=3, num_steps=6, walls=((2, 1),))
        problem = Problem(world, world.hypotheses(), measure="counting")
        figure = plot_inference(infer(sample(learn(problem), Task([0.0, 0.0], [3.0, 2.0]))))
        (wall,) = patches(axes_of(figure), "wall")
        np.testing.assert_allclose(extents(wall), [1.5, 2.5, 0.5, 1.5])
        assert "known constraint" not in legend(figure)

    def test_a_large_grid_is_one_image(self) -> None:
        large = grid(theta=(0.0, TWO_PI, 150), x=(0.0, 9.0, 150))
        samples = make_samples(20, num_hypotheses=len(large))
        result = infer(make_evidence(make_record(hypotheses=large), samples), [crossing()])
        axes = axes_of(plot_inference(result))
        (mesh,) = [c for c in axes.collections if type(c) is QuadMesh]
        assert mesh.get_rasterized()
        assert len(axes.patches) <= 2 + shading.NUM_OUTLINED

    def test_ties_beyond_a_hundred_are_counted(self) -> None:
        cells = grid(theta=(0.0, TWO_PI, 12), x=(0.0, 10.0, 12))
        evidence = evidence_of_columns(np.ones((1, 50, 144), bool), cells)
        axes = axes_of(plot_inference(infer(evidence)))
        assert len(patches(axes, "tied with it")) == shading.NUM_OUTLINED - 1
        assert "44 more are tied" in axes.get_title("left")


class TestPaths:
    def test_demonstrations_break_at_the_wrap_and_reach_both_edges(self) -> None:
        axes = axes_of(plot_inference(inference_of(CELLS, crossing())))
        (line,) = [x for x in axes.lines if x.get_label() == "demonstrations (1)"]
        theta = np.asarray(line.get_xdata())
        steps = np.abs(np.diff(theta))
        assert np.isnan(steps).any()
        assert np.nanmax(steps) < 0.2
        assert axes.get_xlim() == (0.0, TWO_PI)
        assert np.nanmin(theta) <= 0.0
        assert np.nanmax(theta) >= TWO_PI
        assert np.nanmin(theta) > -0.2
        assert np.nanmax(theta) < TWO_PI + 0.2

    def test_starts_and_ends_are_marked_inside_the_picture(self) -> None:
        demonstrations = [make_demonstration(0), crossing()]
        axes = axes_of(plot_inference(inference_of(CELLS, *demonstrations)))
        for label, row in (("start", 0), ("end", -1)):
            (marks,) = [x for x in axes.lines if x.get_label() == label]
            expected = [d.states[row] % [TWO_PI, np.inf] for d in demonstrations]
            np.testing.assert_allclose(np.asarray(marks.get_xydata()), expected)

    def test_nominal_trajectories_are_those_of_tasks_with_demonstrations(self) -> None:
        kept = np.zeros((3, 4, 6, 2)) + np.array([1.0, 2.0, 3.0])[:, None, None, None]
        evidence = make_evidence(samples=make_samples()._replace(kept=kept))
        demonstrations = [make_demonstration(0), crossing()]
        axes = axes_of(plot_inference(infer(evidence, demonstrations)))
        (lines,) = [c for c in axes.collections if type(c) is LineCollection]
        assert sorted(float(np.asarray(path.vertices)[0, 0]) for path in lines.get_paths()) == 4 * [
            1.0
        ] + 4 * [3.0]

    def test_no_more_than_a_hundred_of_them(self) -> None:
        kept = np.random.default_rng(0).normal(size=(3, 90, 6, 2))
        evidence = make_evidence(samples=make_samples()._replace(kept=kept))
        axes = axes_of(plot_inference(infer(evidence)))
        (lines,) = [c for c in axes.collections if type(c) is LineCollection]
        assert 90 < len(lines.get_paths()) <= picture.NUM_LINES

    def test_evidence_without_trajectories_can_be_drawn(self) -> None:
        empty = make_samples()._replace(kept=np.zeros((3, 0, 6, 2)))
        evidence = make_evidence(load_samples=lambda: empty)
        figure = plot_inference(infer(evidence, [crossing()]))
        assert "nominal trajectories" not in legend(figure)

    def test_one_state_is_drawn_against_time(self) -> None:
        figure = plot_inference(inference_of(grid(x=(0.0, 10.0, 5)), crossing()))
        axes = axes_of(figure)
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("time [s]", "x")
        (line,) = [x for x in axes.lines if x.get_label() == "demonstrations (1)"]
        np.testing.assert_allclose(np.asarray(line.get_xdata()), 0.1 * np.arange(12))

    def test_only_angles_have_a_unit(self) -> None:
        axes = axes_of(plot_inference(inference_of()))
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("theta [rad]", "x")


class TestWords:
    def test_the_answer_and_the_settings_are_above(self) -> None:
        result = inference_of()
        said = " ".join(texts(plot_inference(result)).replace("\N{NO-BREAK SPACE}", " ").split())
        assert f"Cell {result.ranking[0]}: theta [" in said
        assert result.evidence.problem.summary in said
        assert texts(plot_inference(result, has_header=False)) == ""

    def test_warnings_are_above(self) -> None:
        evidence = make_evidence()
        summary = evidence.summary._replace(effective_sample_size=np.full(3, 5.0))
        result = infer(make_evidence(summary=summary), [make_demonstration(0)])
        assert "Warning: not to be trusted" in texts(plot_inference(result))

    def test_a_warning_that_asks_ends_in_its_question_mark(self) -> None:
        item = make_demonstration(0)
        times = np.linspace(0.0, 60.0, len(item.states))
        result = infer(make_evidence(), [dataclasses.replace(item, times=times)])
        assert result.warnings[-1].endswith("?")
        said = texts(plot_inference(result)).replace("\n", " ")
        assert result.warnings[-1] in said
        assert "?." not in said

    def test_the_colour_bar_has_the_unit(self) -> None:
        for score, label in (
            ("likelihood", "log-likelihood ratio to no constraint [nats]"),
            ("average", "average violation probability"),
        ):
            bar = plot_inference(inference_of(score=score)).axes[1]
            assert bar.get_ylabel() == label
        prior = plot_inference(infer(make_evidence()))
        assert "were every task shown once [nats]" in prior.axes[1].get_ylabel()

    def test_nothing_left_is_said_and_drawn(self) -> None:
        result = inference_of(grid(x=(0.0, 10.0, 1)))
        figure = plot_inference(result)
        assert "No hypothesis is left" in texts(figure)
        assert len(figure.axes) == 1
        assert patches(axes_of(figure), "struck out")
        assert not patches(axes_of(figure), "ranked first")
        assert "No hypothesis is left" in texts(plot_ranking(result))

    def test_a_narrow_picture_has_its_colour_bar_below(self) -> None:
        figure = plot_inference(inference_of(), width=4.0)
        figure.draw_without_rendering()
        plane, bar = (axes.get_position() for axes in figure.axes)
        assert bar.y1 < plane.y0
        assert figure.get_figwidth() == 4.0

    @pytest.mark.parametrize("width", [4.0, 8.4])
    def test_nothing_is_cut_off_at_the_sides(self, width) -> None:
        result = inference_of()
        for figure in (plot_inference(result, width=width), plot_ranking(result, width=width)):
            figure.draw_without_rendering()
            box = figure.get_tightbbox()
            assert box.x0 > -0.03
            assert box.x1 < width + 0.03

    def test_colours_darken_evenly(self) -> None:
        colours = shading.COLOURS(np.linspace(0, 1, 64))[:, :3]
        light = np.where(colours > 0.04045, ((colours + 0.055) / 1.055) ** 2.4, colours / 12.92)
        lightness = np.cbrt(light @ [0.2126, 0.7152, 0.0722])  # CIE L* but for scale
        steps = -np.diff(lightness)
        assert (steps > 0).all()
        assert steps.max() < 3 * np.median(steps)


class TestRanking:
    def test_bars_are_scores_and_whiskers_errors(self) -> None:
        result = inference_of()
        axes = axes_of(plot_ranking(result))
        (bars,) = [c for c in axes.containers if isinstance(c, BarContainer)]
        shown = result.ranking[: plots.NUM_BARS]
        np.testing.assert_allclose([bar.get_width() for bar in bars], result.score[shown])
        assert bars.errorbar is not None
        (whiskers,) = bars.errorbar.lines[2]
        ends = np.array([segment[:, 0] for segment in whiskers.get_segments()])
        error = result.score_error[shown]
        np.testing.assert_allclose(ends, result.score[shown][:, None] + np.outer(error, [-1, 1]))

    def test_is_cut_after_twelve_and_says_so(self) -> None:
        cells = grid(theta=(0.0, TWO_PI, 10), x=(0.0, 9.0, 10))
        figure = plot_ranking(infer(make_evidence(make_record(hypotheses=cells))))
        assert texts(figure) == "First 12 of 100 cells left"

    def test_ties_are_marked(self) -> None:
        columns = np.zeros((1, 400, 12), bool)
        columns[0, :200, [4, 7]] = True
        columns[0, :100, 8] = True
        axes = axes_of(plot_ranking(infer(evidence_of_columns(columns, CELLS))))
        (bars,) = [c for c in axes.containers if isinstance(c, BarContainer)]
        colours = [to_hex(bar.get_facecolor()) for bar in bars][:3]
        assert colours == [plots.LEADER_BAR, plots.LEADER_BAR, plots.OTHER_BAR]
        named = [text.get_text() for text in axes.texts if "cell" in text.get_text()]
        assert named[0].startswith("1=   cell 4:")
        assert [text.endswith("(tied)") for text in named[:3]] == [True, True, False]
        assert named[2].startswith("3   cell 8:")

    def test_scores_of_zero_can_be_drawn(self) -> None:
        evidence = evidence_of_columns(np.zeros((1, 50, 12), bool), CELLS)
        low, high = axes_of(plot_ranking(infer(evidence))).get_xlim()
        assert low == 0 < high


class TestLabel:
    @pytest.mark.parametrize("side", [1.0, 8.0])
    def test_keeps_off_other_hypotheses_where_there_is_room(self, side: float) -> None:
        """The best is in the middle, large ones all about it but for above or below."""
        other = Box(theta=(0.2, 6.0), x=(side - 1.0, side + 2.0))
        listed = [Box(theta=(2.9, 3.4), x=(4.5, 5.5)), other, Box(theta=(3.6, 6.0), x=(4.0, 6.0))]
        columns = np.zeros((1, 400, 3), bool)
        columns[0, :300, 0] = columns[0, :20, 1] = columns[0, :20, 2] = True
        evidence = evidence_of_columns(columns, ConstraintHypotheses(listed))
        figure = plot_inference(infer(evidence))
        figure.draw_without_rendering()
        axes = axes_of(figure)
        (note,) = [text for text in axes.texts if isinstance(text, Annotation)]
        box = note.get_window_extent().transformed(axes.transData.inverted())
        for constraint in listed:
            low, high, bottom, top = sides(constraint)
            apart = box.x1 < low or box.x0 > high or box.y1 < bottom or box.y0 > top
            assert apart, constraint.name


class TestEdges:
    def test_marks_of_the_axes_lie_above_outlines_at_their_edge(self) -> None:
        axes = axes_of(plot_inference(inference_of()))
        (outline,) = patches(axes, "ranked first")
        assert axes.yaxis.get_zorder() > outline.get_zorder()


class TestFiles:
    @pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
    def test_the_suffix_tells_the_format(self, tmp_path: Path, suffix) -> None:
        path = tmp_path / "new folder" / f"picture.{suffix}"
        inference_of().plot(path)
        assert {"png": b"\x89PNG", "svg": b"<svg", "pdf": b"%PDF"}[suffix] in path.read_bytes()
        if suffix == "png":
            assert imread(path).shape[1] > 1500

    def test_an_unknown_format_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match="Format 'docx' is not supported"):
            inference_of().plot(tmp_path / "picture.docx")
        assert not list(tmp_path.iterdir())

    def test_too_narrow_a_picture_is_refused(self) -> None:
        with pytest.raises(ValueError, match=r"width: expected at least 2\.5 in, got 1\.0"):
            plot_inference(inference_of(), width=1.0)

    def test_neither_pyplot_nor_a_window_is_needed(self, tmp_path: Path) -> None:
        code = (
            "import sys; from test_plots import inference_of; inference_of().plot(sys.argv[1]);"
            "assert 'matplotlib.pyplot' not in sys.modules"
        )
        paths = os.pathsep.join(filter(None, [str(Path(__file__).parent), *sys.path]))
        subprocess.run(
            [sys.executable, "-c", code, str(tmp_path / "picture.png")],
            check=True,
            env=os.environ | {"PYTHONPATH": paths, "MPLBACKEND": "qtagg"},
        )


class TestShapes:
    def test_outlines_are_those_of_the_shapes(self) -> None:
        """Where points are inside the constraint they are inside what is drawn, wraps included."""
        shapes = [
            Ball(1.0, theta=6.1, x=5.0),
            Ball(1.2, x=7.0),
            HalfSpace(8.0, x=1.0),
            StateAction(Ball(0.8, theta=2.2, x=4.0), ActionBox(torque=(0.0, 1.0))),
        ]
        plane = plane_of(make_record(hypotheses=CELLS), [])
        points = np.random.default_rng(0).uniform(plane.limits[:, 0], plane.limits[:, 1], (1500, 2))
        states = np.zeros((1500, 2))
        for k, name in enumerate(plane.names):
            states[:, SPACE.column(name)] = points[:, k]
        for shape in shapes:
            drawn = np.zeros(1500, bool)
            for outline in plane.outlines(shape):
                drawn |= polygons.encloses(outline, points[:, 0], points[:, 1])
            judged = shape.states if isinstance(shape, StateAction) else shape
            inside = judged.contains(states, SPACE)
            assert (drawn != inside).mean() < 0.003, shape.name
            assert 0.02 < inside.mean() < 0.9

    def test_what_is_left_covers_what_is_struck_out(self) -> None:
        listed = [Ball(0.8, theta=2.2, x=4.0), HalfSpace(8.0, x=1.0)]
        axes = axes_of(plot_inference(inference_of(ConstraintHypotheses(listed))))
        (shades,) = [c for c in axes.collections if type(c) is PolyCollection]
        (hatched,) = patches(axes, "struck out")
        assert hatched.get_zorder() < shades.get_zorder()

    @pytest.mark.parametrize("low", [0.0, 0.5])
    def test_windows_show_the_best_that_covers_a_point(self, low: float) -> None:
        made = windows(3, theta=(low, TWO_PI + 0.5 * low, TWO_PI / 5), x=(0.0, 9.0, 2.0))
        result = inference_of(made)
        (mesh,) = [c for c in axes_of(plot_inference(result)).collections if type(c) is QuadMesh]
        shown = np.ma.masked_array(mesh.get_array())
        corner = np.asarray(mesh.get_coordinates(), float)
        middles = 0.5 * (corner[1:, 1:] + corner[:-1, :-1])
        inside = [made.constraint(k).contains(middles, SPACE) for k in range(len(made))]
        expected = np.where(inside, result.score[:, None, None], -np.inf).max(axis=0)
        np.testing.assert_array_equal(np.ma.filled(shown, -np.inf), expected)
        assert np.isneginf(expected).any()


class TestActionsInStates:
    PLACE = StateAction(Box(theta=(1.0, 2.0), x=(3.0, 6.0)), ActionBox(u=(0.0, 1.0)))

    def drawn(self, **changes) -> Figure:
        listed = [self.PLACE, Box(theta=(3.0, 4.0), x=(3.0, 6.0))]
        record = make_record(hypotheses=ConstraintHypotheses(listed), **changes)
        samples = make_samples(num_hypotheses=2)
        return plot_inference(infer(make_evidence(record, samples)))

    def test_are_crossed_in_their_colour_and_named_and_not_filled(self) -> None:
        figure = self.drawn()
        axes = axes_of(figure)
        (shades,) = [c for c in axes.collections if type(c) is PolyCollection]
        assert len(shades.get_paths()) == 1
        (crossed,) = patches(axes, "action u [0, 1) forbidden in")
        np.testing.assert_allclose(extents(crossed), [1.0, 2.0, 3.0, 6.0])
        assert crossed.get_hatch() == "xx"
        assert to_rgba(crossed.get_facecolor())[3] == 0.0
        assert "action u [0, 1) forbidden in" in legend(figure)

    def test_the_outline_of_the_best_does_not_fill_them(self) -> None:
        record = make_record(hypotheses=ConstraintHypotheses([self.PLACE]))
        figure = plot_inference(infer(make_evidence(record, make_samples(num_hypotheses=1))))
        (outline,) = patches(axes_of(figure), "ranked first")
        assert to_rgba(outline.get_facecolor())[3] == 0.0

    def test_known_ones_are_told_from_known_constraints(self) -> None:
        axes = axes_of(self.drawn(known=(self.PLACE, Box(x=(4.0, 4.5)))))
        (crossed,) = patches(axes, "known constraint on actions")
        assert to_rgba(crossed.get_facecolor())[3] == 0.0
        (filled,) = [p for p in patches(axes, "known") if p.get_label() == "known constraint"]
        np.testing.assert_allclose(extents(filled)[2:], [4.0, 4.5])


class TestPosterior:
    def test_shows_probabilities_and_says_that_of_none(self, tmp_path: Path) -> None:
        result = inference_of()
        figure = plot_posterior(result, tmp_path / "posterior.png")
        assert (tmp_path / "posterior.png").stat().st_size > 10_000
        axes = axes_of(figure)
        (mesh,) = [c for c in axes.collections if type(c) is QuadMesh]
        shown = np.ma.masked_array(mesh.get_array())
        expected = result.posterior.hypotheses.reshape(CELLS.shape).T
        np.testing.assert_array_equal(shown.compressed(), expected[~np.ma.getmaskarray(shown)])
        assert " ".join(texts(figure).split()).startswith(result.belief)
        assert figure.axes[1].get_ylabel() == "posterior probability"

    def test_the_credible_set_has_one_outline(self) -> None:
        result = inference_of()
        axes = axes_of(plot_posterior(result))
        chosen = result.credible_set().hypotheses
        (lines,) = [c for c in axes.collections if "credible" in str(c.get_label())]
        outlined = np.zeros(CELLS.shape, bool)
        outlined.reshape(-1)[chosen] = True
        padded = np.pad(outlined, 1)
        num_sides = sum(int((np.diff(padded.astype(int), axis=k) != 0).sum()) for k in (0, 1))
        assert isinstance(lines, LineCollection)
        assert len(lines.get_segments()) == num_sides
        (best,) = patches(axes, "most probable")
        np.testing.assert_allclose(extents(best), sides(CELLS.constraint(int(chosen[0]))))

    def test_a_best_hypothesis_without_a_place_is_named(self) -> None:
        columns = np.zeros((1, 400, 2), bool)
        columns[0, :390, 0] = columns[0, :20, 1] = True
        listed = [ActionBox(u=(0.5, 1.0)), Box(theta=(1.0, 2.0), x=(3.0, 4.0))]
        acting = dataclasses.replace(make_demonstration(0), actions=np.zeros((4, 1)))
        result = infer(evidence_of_columns(columns, ConstraintHypotheses(listed)), [acting])
        figure = plot_posterior(result)
        said = " ".join(texts(figure).split())
        assert "no place on these axes: hypothesis 0: action u [0.5, 1), " in said
        assert not patches(axes_of(figure), "most probable")
        assert "no place" not in texts(plot_posterior(inference_of()))

    def test_the_best_is_called_most_probable_where_it_is(self) -> None:
        for share, label in ((390, "most probable"), (20, "most probable of the hypotheses")):
            columns = np.zeros((1, 400, 12), bool)
            columns[0, :share, 4] = True
            result = infer(evidence_of_columns(columns, CELLS), [make_demonstration(0)])
            found = result.posterior
            assert bool(found.hypotheses.max() > found.none) is (label == "most probable")
            figure = plot_posterior(result)
            assert label in legend(figure)
            none = [text for text in legend(figure) if text.startswith("no constraint: ")]
            assert none == [f"no constraint: {phrases.probability(found.none, found.none_error)}"]

    def test_a_colour_means_the_same_probability_in_every_picture(self) -> None:
        for figure in (plot_posterior(inference_of()), plot_posterior(infer(make_evidence()))):
            (mesh,) = [c for c in axes_of(figure).collections if type(c) is QuadMesh]
            assert (mesh.norm.vmin, mesh.norm.vmax) == (0.0, 1.0)
            ticks = {tick.get_text() for tick in figure.axes[1].get_yticklabels()}
            assert {"0", "1 %", "100 %"} <= ticks
            few = np.asarray(mesh.norm(np.array([0.002, 0.006, 0.03])))
            assert (np.diff(few) > 0.05).all()
            assert few.max() < 0.35
