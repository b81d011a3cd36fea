"""Draw an inference: shaded hypotheses, the ranking, and what each demonstration contributes.

    colour = score of a hypothesis,    hatch = a demonstration enters it,    outline = first rank
    colour = posterior probability,    outline = 95 % credible set
    bars = scores of the ranking, or log L_d(c) of each demonstration, whose sum is log L(c)

Every number is one that the inference holds; none is computed here.

Shapes: D demonstrations, H hypotheses.
"""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation, Transform

from swerve.base.arguments import whole_number
from swerve.base.figure_style import ALARM, FAINT, INK, WIDTH, headed, open_sides, written
from swerve.base.phrases import counted, cut, ended, probability, wrapped
from swerve.inference.ranking import Ranking
from swerve.presentation import sentences
from swerve.presentation.plane_picture import picture
from swerve.presentation.shading import Shading, of_probability
from swerve.trust import doubts

NUM_BARS = 12  # hypotheses in the picture of the ranking
MAX_CONTRIBUTIONS = 40  # demonstrations in the picture of contributions: those that say most
MAX_WARNING = 300  # characters of a warning; the report has all of them
LEADER_BAR, OTHER_BAR = "#5b1a78", "#bcaec4"
FOR, AGAINST = LEADER_BAR, ALARM  # colours of bars that speak for and against a hypothesis


def plot_inference(
    inference: Ranking,
    path: str | Path | None = None,
    *,
    width: float = WIDTH,
    has_header: bool = True,
) -> Figure:
    """Draw hypotheses shaded by score, nominal trajectories and demonstrations.

    Args:
      inference: the ranking to draw.
      path: a file to write, whose suffix tells the format, or None.
      width: width of the picture [in]; text keeps its size; below 6 in the layout is for a phone.
      has_header: whether to write the answer, the warnings and the settings above the picture.

    Raises:
      ValueError: if matplotlib knows no such format, or the picture is too narrow for its text.
    """
    header = _header(inference, sentences.title(inference)) if has_header else []
    return written(picture(inference, _by_score(inference), header, width), path)


def plot_posterior(
    inference: Ranking, path: str | Path | None = None, *, width: float = WIDTH
) -> Figure:
    """Draw hypotheses shaded by posterior probability, the 95 % credible set outlined.

    The header and the legend tell the probability that there is no constraint.

    Args:
      inference: the ranking to draw.
      path: a file to write, whose suffix tells the format, or None.
      width: width of the picture [in].

    Raises:
      ValueError: if matplotlib knows no such format, or the picture is too narrow for its text.
    """
    header = _header(inference, sentences.belief(inference))
    return written(picture(inference, _by_posterior(inference), header, width), path)


def plot_ranking(
    inference: Ranking, path: str | Path | None = None, *, width: float = WIDTH
) -> Figure:
    """Draw the first hypotheses of the ranking as bars with their standard errors.

    Args:
      inference: the ranking to draw.
      path: a file to write, whose suffix tells the format, or None.
      width: width of the picture [in].

    Raises:
      ValueError: if matplotlib knows no such format, or the picture is too narrow for its text.
    """
    shown, total = inference.ranking[:NUM_BARS], len(inference.ranking)
    title = f"First {len(shown)} of {counted(total, sentences.noun(inference))} left"
    header = [(title if total else sentences.title(inference), 11.5, INK)]
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
    _name_bars(axes, inference, width, reach)
    axes.set(xlim=(0, reach / (1 - 0.95 / width)), ylim=(len(shown) - 0.6, -0.75), yticks=[])
    open_sides(axes)
    label = f"{sentences.score_label(inference)}; whiskers: standard error"
    axes.set_xlabel(wrapped(label, width - 0.5, 8.5), fontsize=8.5)
    return written(figure, path)


def _name_bars(axes: Axes, inference: Ranking, width: float, reach: float) -> None:
    """Write rank and name above the bars of `plot_ranking`, and the score at their ends.

    Args:
      axes: axes with one bar a row, from row 0.
      inference: the ranking drawn.
      width: width of the picture [in].
      reach: where the longest whisker ends, in units of the score.
    """
    style: dict[str, Any] = {"fontsize": 8, "color": INK, "parse_math": False}
    for row, index in enumerate(inference.ranking[:NUM_BARS].tolist()):
        tied = " (tied)" if inference.rank[row] == 1 and len(inference.leaders) > 1 else ""
        text = cut(sentences.hypothesis(inference, index), int(width * 14) - len(tied))
        text = f"{sentences.rank(inference, row)}   {text}{tied}"
        axes.text(0.005 * reach, row - 0.25, text, va="bottom", **style)
        end = float(inference.score[index] + inference.score_error[index])
        axes.text(
            end + 0.015 * reach, row, sentences.number(inference, index), va="center", **style
        )


def plot_contributions(
    inference: Ranking,
    hypothesis: int | None = None,
    path: str | Path | None = None,
    *,
    width: float = WIDTH,
) -> Figure:
    """Draw what each demonstration says for or against a hypothesis, in nats.

    Demonstrations that enter the hypothesis are drawn to the left, with a cross where they rule it
    out. A demonstration that avoids the hypothesis says the more, the more often a demonstrator
    under no constraint would have entered it.

    Args:
      inference: inference from at least one demonstration.
      hypothesis: its index; the best of the ranking if None.
      path: a file to write, whose suffix tells the format, or None.
      width: width of the picture [in].

    Raises:
      ValueError: if there is no demonstration or no such hypothesis, no hypothesis is left and
        none is named, or matplotlib knows no such format.
    """
    index = _chosen(inference, hypothesis)
    values = inference.contributions[:, index]
    size = np.where(np.isneginf(values), np.inf, np.abs(values))
    shown = np.sort(np.argsort(-size, kind="stable")[:MAX_CONTRIBUTIONS])
    shown = shown[np.argsort(-values[shown], kind="stable")]
    total = inference.log_likelihood[index]
    answer = "ruled out" if np.isneginf(total) else f"{total:.2f} nats in all"
    name = sentences.short_hypothesis(inference, index)
    header = [
        (f"What demonstrations say about {name}", 11.5, INK),
        (f"{answer}; {_shares(inference, index)}", 8.0, FAINT),
    ]
    figure = headed(header, width, 0.19 * len(shown) + 0.9, width)
    axes = figure.add_subplot()
    _draw_contributions(axes, values[shown])
    _name_rows(axes, inference, shown)
    return written(figure, path)


def _chosen(inference: Ranking, hypothesis: int | None) -> int:
    """Return the index of the hypothesis to draw.

    Raises:
      ValueError: under the conditions of `plot_contributions`.
    """
    if not inference.demonstrations:
        raise ValueError("plot_contributions: expected an inference from demonstrations, got none")
    if hypothesis is None:
        if not len(inference.ranking):
            raise ValueError("plot_contributions: no hypothesis is left; name one by its index")
        return int(inference.ranking[0])
    index, num = whole_number(hypothesis, "hypothesis", 0), len(inference.prior) - 1
    if index >= num:
        raise ValueError(f"hypothesis: expected an index from 0 to {num - 1}, got {index}")
    return index


def _shares(inference: Ranking, index: int) -> str:
    """Return how many demonstrations avoid and how many enter a hypothesis."""
    is_counted = inference.is_counted[inference.task_of, index]
    entering = int((inference.entered[:, index] & is_counted).sum())
    num, avoiding = len(is_counted), int(is_counted.sum()) - entering
    parts = [
        f"of {counted(num, 'demonstration')} {avoiding} avoid it",
        f"{entering} enter it" + " (hatched; crosses rule it out)" * bool(entering),
    ]
    if not is_counted.all():
        parts.append(f"{int((~is_counted).sum())} start or end too near to it to count")
    return ", ".join(parts)


def _draw_contributions(axes: Axes, values: np.ndarray) -> None:
    """Draw contributions [nats] as bars, one a row; a cross for -inf, which rules out."""
    is_out, rows = np.isneginf(values), np.arange(len(values))
    lengths = np.where(is_out, 0.0, values)
    colours = [FOR if value > 0.0 else AGAINST for value in lengths]
    hatches = ["" if value >= 0.0 else "////" for value in lengths]
    axes.barh(rows, lengths, 0.7, color=colours, hatch=hatches)
    axes.use_sticky_edges = False  # leaves room at the left of zero
    crosses = {"color": AGAINST, "ms": 6, "transform": _left_of_zero(axes)}
    axes.plot(np.zeros(is_out.sum()), rows[is_out], "X", **crosses)
    axes.axvline(0.0, color=INK, lw=0.8)
    axes.set(ylim=(len(rows) - 0.4, -0.6))
    axes.set_xlabel("log-likelihood ratio of a demonstration to no constraint [nats]", fontsize=8.5)
    open_sides(axes)
    axes.spines["left"].set_visible(False)


def _left_of_zero(axes: Axes) -> Transform:
    """Return the transform that moves crosses left of zero, where bars against are drawn."""
    inches = cast(Figure, axes.figure).dpi_scale_trans
    return axes.transData + ScaledTranslation(-7 / 72, 0.0, inches)


def _name_rows(axes: Axes, inference: Ranking, shown: np.ndarray) -> None:
    """Write the names of the demonstrations `shown` beside their rows; say how many are not."""
    names = _names(inference)
    axes.set_yticks(np.arange(len(shown)), [names[d] for d in shown])
    for label in axes.get_yticklabels():
        label.set_parse_math(False)
    left_out = len(inference.demonstrations) - len(shown)
    if left_out:
        note = f"The {len(shown)} demonstrations that say most are drawn, {left_out} are not"
        axes.set_title(note, fontsize=7.5, color=FAINT)


def _names(inference: Ranking) -> list[str]:
    """Return the names of demonstrations, equal names numbered: 'demo', 'demo (2)'."""
    counts: Counter[str] = Counter()
    names = []
    for demonstration in inference.demonstrations:
        name = cut(demonstration.name, 24)
        counts[name] += 1
        names.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return names


def _by_score(inference: Ranking) -> Shading:
    """Return the shading of `plot_inference`: by score, the first rank outlined."""
    most = float(inference.score[inference.ranking].max(initial=0.0)) or 1.0
    return Shading(
        inference.score,
        Normalize(0.0, most),
        sentences.score_label(inference),
        inference.leaders,
        ("ranked first", "tied with it"),
        partial(sentences.score, inference),
        is_set=False,
    )


def _by_posterior(inference: Ranking) -> Shading:
    """Return the shading of `plot_posterior`: by probability, the credible set outlined."""
    found = inference.posterior
    values = np.where(inference.struck_out, -np.inf, found.hypotheses)
    is_best = found.hypotheses.max(initial=0.0) >= found.none
    best = "most probable" if is_best else "most probable of the hypotheses"

    def text(index: int) -> str:
        return probability(found.hypotheses[index], found.error[index])

    return Shading(
        values,
        of_probability(),
        "posterior probability",
        inference.credible_set().hypotheses,
        (best, "in the 95 % credible set"),
        text,
        is_set=True,
        none=(found.none, f"no constraint: {probability(found.none, found.none_error)}"),
    )


def _header(inference: Ranking, title: str) -> list[tuple[str, float, str]]:
    """Return the lines above a picture: a title, the warnings and the settings."""
    warnings = [ended(cut(text, MAX_WARNING)) for text in doubts.warnings(inference)]
    return [
        (title, 11.5, INK),
        *((f"Warning: {text}", 8.0, ALARM) for text in warnings),
        (sentences.settings(inference), 7.5, FAINT),
    ]
