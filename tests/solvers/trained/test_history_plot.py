"""The picture of how training went."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from support.brief_training import with_history

from swerve.solvers.trained.history_plot import FORBIDDEN, plot_training
from swerve.solvers.trained.probe import Progress


class TestPlot:
    @pytest.mark.parametrize("suffix", ["png", "svg"])
    def test_is_written(self, tmp_path: Path, suffix: str) -> None:
        path = tmp_path / "new" / f"a.{suffix}"
        with_history().plot_training(path)
        assert path.stat().st_size > 10_000
        if suffix == "png":
            assert imread(path).std() > 0.05

    def test_shows_the_history(self) -> None:
        nominal = with_history()
        figure = plot_training(nominal)
        kl, share, residual = figure.axes
        assert [axes.get_ylabel() for axes in figure.axes] == [
            "KL [nats]",
            "ESS / N [%]",
            "residual [nats]",
        ]
        assert (kl.get_yscale(), share.get_yscale(), residual.get_yscale()) == (
            "log",
            "linear",
            "log",
        )
        assert residual.get_xlabel() == "time [min]"
        lines = {line.get_label(): line for line in kl.lines}
        history = Progress(*nominal.history.T)
        for line, values in (
            (lines["median"], history.kl),
            (lines["worst task"], history.worst_kl),
            (share.lines[0], 100 * history.effective_share),
            (residual.lines[0], history.residual),
        ):
            np.testing.assert_allclose(np.asarray(line.get_xdata()), history.seconds / 60)
            np.testing.assert_allclose(np.asarray(line.get_ydata()), values)
        assert lines["median"].get_linestyle() != lines["worst task"].get_linestyle()
        title = figure.texts[0].get_text().replace("\xa0", " ")
        assert title == "ppo after 8.33 min, 20 million steps: KL 0.30 nats, ESS 80 %"

    def test_marks_steps_where_time_had_come_to_them(self) -> None:
        seconds = 500.0 * np.linspace(0.1, 1.0, 10) ** 2
        figure = plot_training(with_history(seconds=seconds))
        figure.draw_without_rendering()
        (top,) = figure.axes[0].child_axes
        assert top.get_xlabel() == "environment steps [millions]"
        marked = [(float(x.get_text()), x.get_position()[0]) for x in top.get_xticklabels()]
        assert len(marked) >= 4
        millions, minutes = np.transpose(marked)
        expected = np.interp(millions, 20.0 * np.linspace(0.1, 1.0, 10), seconds / 60)
        np.testing.assert_allclose(minutes, expected)

    def test_of_short_trainings_is_in_seconds(self) -> None:
        figure = plot_training(with_history(seconds=np.arange(1.0, 11.0)))
        assert figure.axes[-1].get_xlabel() == "time [s]"

    @pytest.mark.parametrize(
        "columns",
        [{"kl": np.inf, "worst_kl": np.inf, "effective_share": 0.0}, {"kl": -1e-9, "worst_kl": 0}],
        ids=["all-forbidden", "no-divergence"],
    )
    def test_of_what_a_logarithm_cannot_show(self, columns: dict, tmp_path: Path) -> None:
        figure = plot_training(with_history(**columns), tmp_path / "a.png")
        said = " ".join(text.get_text() for text in figure.texts).replace("\xa0", " ")
        assert (FORBIDDEN in said) == np.isinf(columns["kl"])

    def test_nothing_overlaps(self) -> None:
        figure = plot_training(with_history())
        figure.draw_without_rendering()
        renderer = figure.canvas.get_renderer()  # pyright: ignore[reportAttributeAccessIssue]
        boxes = [axes.get_tightbbox(renderer) for axes in figure.axes]
        boxes += [figure.legends[0].get_window_extent(renderer)]
        boxes += [text.get_window_extent(renderer) for text in figure.texts]
        for k, box in enumerate(boxes):
            assert box is not None
            assert box.y0 >= 0
            assert box.x1 <= figure.bbox.width
            assert not any(
                box.shrunk(0.999, 0.999).overlaps(other) for other in boxes[k + 1 :] if other
            )
