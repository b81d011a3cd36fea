"""The plot of a posterior."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection, QuadMesh
from support.pictures import CELLS, axes_of, extents, inference_of, legend, patches, sides, texts
from support.synthetic import evidence_of_columns, make_demonstration, make_evidence

from swerve.answer import infer
from swerve.base import phrases
from swerve.constraints.boxes import ActionBox, Box
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.presentation.plots import plot_posterior


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
