"""Plots of an inference: words, bars of the ranking, files."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.container import BarContainer
from matplotlib.image import imread
from support.pictures import CELLS, axes_of, inference_of, patches, texts
from support.synthetic import evidence_of_columns, make_demonstration, make_evidence, make_record

from swerve.answer import infer
from swerve.base.space import TWO_PI
from swerve.hypotheses.grid import grid
from swerve.presentation import plots, shading
from swerve.presentation.plots import plot_inference, plot_ranking


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
        times = np.linspace(0.0, 0.8, len(item.states))  # no unit explains it
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
        assert "if each task is shown once [nats]" in prior.axes[1].get_ylabel()

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
            "import sys; from support.pictures import inference_of;"
            "inference_of().plot(sys.argv[1]);"
            "assert 'matplotlib.pyplot' not in sys.modules"
        )
        paths = os.pathsep.join(filter(None, sys.path))
        subprocess.run(
            [sys.executable, "-c", code, str(tmp_path / "picture.png")],
            check=True,
            env=os.environ | {"PYTHONPATH": paths, "MPLBACKEND": "qtagg"},
        )
