"""Hypotheses in a plot: colours, outlines, hatching, and what hides what."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from support.pictures import (
    CELLS,
    axes_of,
    crossing,
    extents,
    inference_of,
    legend,
    patches,
    sides,
    texts,
)
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
from swerve.answer import infer
from swerve.base.space import TWO_PI, Task
from swerve.constraints import polygon_geometry
from swerve.constraints.boxes import ActionBox, Box
from swerve.constraints.predicate import Predicate
from swerve.constraints.shapes import Ball, HalfSpace
from swerve.constraints.state_action import StateAction
from swerve.constraints.stored import constraint_from_json
from swerve.demonstrations.demonstration import Demonstration
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.grid import grid
from swerve.presentation import shading
from swerve.presentation.plane import plane_of
from swerve.presentation.plots import plot_inference


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
        assert "best of the cells along omega" in axes.get_title("left")

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
                drawn |= polygon_geometry.encloses(outline, points[:, 0], points[:, 1])
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
        (crossed,) = patches(axes, "action u [0, 1) forbidden here")
        np.testing.assert_allclose(extents(crossed), [1.0, 2.0, 3.0, 6.0])
        assert crossed.get_hatch() == "xx"
        assert to_rgba(crossed.get_facecolor())[3] == 0.0
        assert "action u [0, 1) forbidden here" in legend(figure)

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
