"""The picture of contributions: its bars are those of the inference."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from matplotlib.patches import Rectangle
from support.synthetic import make_demonstration, make_evidence

from swerve import infer, plot_contributions
from swerve.answer import Inference


def from_demonstrations(tolerance: float, num: int = 6) -> Inference:
    """An inference from some demonstrations and a stray one, which enters cell 2."""
    made = [make_demonstration(k % 3, f"demo_{k}") for k in range(num)]
    stray = make_demonstration(0, "stray", x=7.0)
    return infer(make_evidence(), [*made, stray], tolerance=tolerance)


class TestContributions:
    def test_bars_are_the_contributions(self) -> None:
        result = from_demonstrations(tolerance=0.1)
        figure = plot_contributions(result, 2)
        bars = [bar.get_width() for bar in figure.axes[0].patches if isinstance(bar, Rectangle)]
        values = np.sort(result.contributions[:, 2])[::-1]
        np.testing.assert_allclose(bars, values)
        assert bars[-1] == pytest.approx(np.log(0.1))
        names = [label.get_text() for label in figure.axes[0].get_yticklabels()]
        assert names[-1] == "stray"
        said = " ".join(" ".join(text.get_text() for text in figure.texts).split())
        assert "of 7 demonstrations 6 avoid it, 1 enter it" in said
        assert f"{result.log_likelihood[2]:.2f} nats in all" in said

    def test_what_rules_out_is_crossed(self) -> None:
        figure = plot_contributions(from_demonstrations(tolerance=0.0), 2)
        [crosses] = [line for line in figure.axes[0].lines if line.get_marker() == "X"]
        np.testing.assert_array_equal(crosses.get_xydata(), [[0.0, 6.0]])
        assert "ruled out" in " ".join(text.get_text() for text in figure.texts)

    def test_crosses_are_beside_the_line_at_zero_and_inside_the_axes(self) -> None:
        figure = plot_contributions(from_demonstrations(tolerance=0.0), 2)
        figure.draw_without_rendering()
        axes = figure.axes[0]
        [crosses] = [line for line in axes.lines if line.get_marker() == "X"]
        [[x, _]] = crosses.get_transform().transform(crosses.get_xydata())
        radius = crosses.get_markersize() / 2 * figure.dpi / 72
        assert axes.bbox.x0 < x - radius
        assert x + radius < axes.transData.transform((0.0, 0.0))[0]

    def test_demonstrations_of_one_name_are_told_apart(self) -> None:
        made = [make_demonstration(k, name) for k, name in enumerate(["a", "b", "a"])]
        figure = plot_contributions(infer(make_evidence(), made), 2)
        names = {label.get_text() for label in figure.axes[0].get_yticklabels()}
        assert names == {"a", "b", "a (2)"}

    def test_the_best_is_drawn_unless_named(self, tmp_path: Path) -> None:
        result = from_demonstrations(tolerance=0.0)
        figure = plot_contributions(result, path=tmp_path / "a.png")
        assert f"cell {result.ranking[0]}:" in figure.texts[0].get_text()
        assert imread(tmp_path / "a.png").std() > 0.05

    def test_of_many_those_that_say_most(self) -> None:
        figure = plot_contributions(from_demonstrations(tolerance=0.0, num=60), 2)
        assert len(figure.axes[0].patches) == 40
        assert (
            figure.axes[0].get_title()
            == "The 40 demonstrations that say most are drawn, 21 are not"
        )
        assert any(label.get_text() == "stray" for label in figure.axes[0].get_yticklabels())

    def test_bad_input(self) -> None:
        with pytest.raises(ValueError, match="expected an inference from demonstrations, got none"):
            plot_contributions(infer(make_evidence()))
        with pytest.raises(ValueError, match="expected an index from 0 to 11, got 12"):
            plot_contributions(from_demonstrations(0.0), 12)
        wanderer = make_demonstration(0, "wanderer", num_states=13)
        wanderer.states[1:, 1] = np.tile([1.0, 4.0, 7.0], 4)
        wanderer.states[1:, 0] = np.repeat([0.5, 2.0, 4.0, 5.0], 3)
        with pytest.raises(ValueError, match="no hypothesis is left; name one by its index"):
            plot_contributions(infer(make_evidence(), [wanderer]))
