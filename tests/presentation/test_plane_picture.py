"""Paths, labels and edges in a plot of two states."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.text import Annotation
from support.pictures import CELLS, axes_of, crossing, inference_of, legend, patches, sides
from support.synthetic import evidence_of_columns, make_demonstration, make_evidence, make_samples

from swerve.answer import infer
from swerve.base.space import TWO_PI
from swerve.constraints.boxes import Box
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.hypotheses.grid import grid
from swerve.presentation import plane_picture as picture
from swerve.presentation.plots import plot_inference


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

    def test_of_many_demonstrations_some_are_drawn_and_the_legend_says_so(self) -> None:
        """They are spread over all: the first and the last are among them."""
        num = picture.MAX_DRAWN
        demonstrations = [crossing() for _ in range(1000)]
        drawn = picture.evenly(demonstrations, num)
        assert len({id(item) for item in drawn}) == len(drawn) == num
        assert (drawn[0], drawn[-1]) == (demonstrations[0], demonstrations[-1])
        assert picture.evenly(demonstrations[:num], num) == demonstrations[:num]
        figure = plot_inference(inference_of(CELLS, *demonstrations))
        assert f"demonstrations ({num} of 1,000 are drawn)" in legend(figure)
        (starts,) = [x for x in axes_of(figure).lines if x.get_label() == "start"]
        assert len(np.asarray(starts.get_xydata())) == num

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
