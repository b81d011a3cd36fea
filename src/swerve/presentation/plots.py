"""Pictures of an inference: drawn from what it holds, nothing is computed anew.

    colour = score of a hypothesis,    hatch = a demonstration enters it,    outline = first rank

or colour = posterior probability, outline = 95 % credible set; and the ranking as bars.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from swerve.base.figure_style import ALARM, FAINT, INK, WIDTH, headed, open_sides, written
from swerve.inference.ranking import Inference
from swerve.presentation import sentences as wording
from swerve.presentation.plane_picture import picture
from swerve.presentation.shading import Shading, of_probability

NUM_BARS = 12
MAX_WARNING = 300  # characters of a warning; the report has all of them
LEADER_BAR, OTHER_BAR = "#5b1a78", "#bcaec4"


def plot_inference(
    inference: Inference,
    path: str | Path | None = None,
    *,
    width: float = WIDTH,
    has_header: bool = True,
) -> Figure:
    """Draw hypotheses shaded by score, nominal trajectories and demonstrations.

    Args:
      inference: what to draw.
      path: a file to write, whose suffix tells the format, or None.
      width: of the picture [in]; text keeps its size, and below 6 in the layout is for a phone.
      has_header: whether to write the answer, the warnings and the settings above it.

    Raises:
      ValueError: if matplotlib knows no such format, or it is too narrow for its text.
    """
    header = _header(inference, wording.title(inference)) if has_header else []
    return written(picture(inference, _by_score(inference), header, width), path)


def plot_posterior(
    inference: Inference, path: str | Path | None = None, *, width: float = WIDTH
) -> Figure:
    """Draw hypotheses shaded by posterior probability, the 95 % credible set outlined.

    The header and the legend tell the probability that there is no constraint.

    Args:
      inference: what to draw.
      path: a file to write, whose suffix tells the format, or None.
      width: of the picture [in].

    Raises:
      ValueError: if matplotlib knows no such format, or it is too narrow for its text.
    """
    header = _header(inference, inference.belief)
    return written(picture(inference, _by_posterior(inference), header, width), path)


def plot_ranking(
    inference: Inference, path: str | Path | None = None, *, width: float = WIDTH
) -> Figure:
    """Draw the first hypotheses of the ranking as bars with their standard errors.

    Args:
      inference: what to draw.
      path: a file to write, whose suffix tells the format, or None.
      width: of the picture [in].

    Raises:
      ValueError: if matplotlib knows no such format, or it is too narrow for its text.
    """
    shown, total = inference.ranking[:NUM_BARS], len(inference.ranking)
    title = f"First {len(shown)} of {wording.counted(total, wording.noun(inference))} left"
    header = [(title if total else wording.title(inference), 11.5, INK)]
    figure = headed(header, width, 0.42 * len(shown) + 0.8, width)
    axes = figure.add_subplot()
    if not total:
        axes.set_axis_off()
        return written(figure, path)
    score, error = inference.score[shown], inference.score_error[shown]
    is_first = inference.rank[: len(shown)] == 1
    colours = [LEADER_BAR if first else OTHER_BAR for first in is_first]
    whiskers = {"ecolor": INK, "elinewidth": 1.2, "capsize": 3}
    axes.barh(np.arange(len(shown)), score, 0.4, color=colours, xerr=error, error_kw=whiskers)
    reach = float((score + error).max()) or 1.0
    style: dict[str, Any] = {"fontsize": 8, "color": INK, "parse_math": False}
    for row, index in enumerate(shown.tolist()):
        tied = " (tied)" if is_first[row] and len(inference.leaders) > 1 else ""
        text = wording.cut(wording.hypothesis(inference, index), int(width * 14) - len(tied))
        text = f"{wording.rank(inference, row)}   {text}{tied}"
        axes.text(0.005 * reach, row - 0.25, text, va="bottom", **style)
        end = score[row] + error[row] + 0.015 * reach
        axes.text(end, row, wording.number(inference, index), va="center", **style)
    axes.set(xlim=(0, reach / (1 - 0.95 / width)), ylim=(len(shown) - 0.6, -0.75), yticks=[])
    open_sides(axes)
    label = f"{wording.score_label(inference)}; whiskers: standard error"
    axes.set_xlabel(wording.wrapped(label, width - 0.5, 8.5), fontsize=8.5)
    return written(figure, path)


def _by_score(inference: Inference) -> Shading:
    """Return what `plot_inference` draws: scores, and the first rank outlined."""
    most = float(inference.score[inference.ranking].max(initial=0.0)) or 1.0
    return Shading(
        inference.score,
        Normalize(0.0, most),
        wording.score_label(inference),
        inference.leaders,
        ("ranked first", "tied with it"),
        partial(wording.score, inference),
        is_set=False,
    )


def _by_posterior(inference: Inference) -> Shading:
    """Return what `plot_posterior` draws: probabilities, and the credible set outlined."""
    found = inference.posterior
    values = np.where(inference.struck_out, -np.inf, found.hypotheses)
    is_best = found.hypotheses.max(initial=0.0) >= found.none
    best = "most probable" if is_best else "most probable of the hypotheses"

    def text(index: int) -> str:
        return wording.probability(found.hypotheses[index], found.error[index])

    return Shading(
        values,
        of_probability(),
        "posterior probability",
        inference.credible_set().hypotheses,
        (best, "in the 95 % credible set"),
        text,
        is_set=True,
        none=(found.none, f"no constraint: {wording.probability(found.none, found.none_error)}"),
    )


def _header(inference: Inference, title: str) -> list[tuple[str, float, str]]:
    warnings = [wording.ended(wording.cut(text, MAX_WARNING)) for text in inference.warnings]
    return [
        (title, 11.5, INK),
        *((f"Warning: {text}", 8.0, ALARM) for text in warnings),
        (wording.settings(inference), 7.5, FAINT),
    ]
