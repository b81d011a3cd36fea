"""Pictures of what is believed: which demonstrations speak for and against a hypothesis.

    log L(c) = sum_d log L_d(c)

Shapes: D demonstrations, H hypotheses.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation, Transform

from swerve.base.arguments import whole_number
from swerve.base.figure_style import ALARM, FAINT, INK, WIDTH, headed, open_sides, written
from swerve.inference.ranking import Inference
from swerve.presentation import sentences as wording

MAX_ROWS = 40  # demonstrations drawn, those that say most
FOR = "#5b1a78"


def plot_contributions(
    inference: Inference,
    hypothesis: int | None = None,
    path: str | Path | None = None,
    *,
    width: float = WIDTH,
) -> Figure:
    """Draw what each demonstration says for or against a hypothesis, in nats.

    Those that enter it are drawn to the left, and where they rule it out a cross marks them. Of
    those that avoid it, what a demonstrator under no constraint would have entered most often says
    most.

    Args:
      inference: from at least one demonstration.
      hypothesis: its index; the best of the ranking if None.
      path: a file to write, whose suffix tells the format, or None.
      width: of the picture [in].

    Raises:
      ValueError: if there is no demonstration or no such hypothesis, none is left and none is
        named, or matplotlib knows no such format.
    """
    index = _chosen(inference, hypothesis)
    values = inference.contributions[:, index]
    size = np.where(np.isneginf(values), np.inf, np.abs(values))
    shown = np.sort(np.argsort(-size, kind="stable")[:MAX_ROWS])
    shown = shown[np.argsort(-values[shown], kind="stable")]
    total = inference.log_likelihood[index]
    answer = "ruled out" if np.isneginf(total) else f"{total:.2f} nats in all"
    header = [
        (f"What demonstrations say of {wording.short_hypothesis(inference, index)}", 11.5, INK),
        (f"{answer}; {_shares(inference, index)}", 8.0, FAINT),
    ]
    figure = headed(header, width, 0.19 * len(shown) + 0.9, width)
    axes = figure.add_subplot()
    is_out = np.isneginf(values[shown])
    drawn = np.where(is_out, 0.0, values[shown])
    colours = [FOR if value > 0.0 else ALARM for value in drawn]
    rows = np.arange(len(shown))
    axes.barh(rows, drawn, 0.7, color=colours, hatch=["" if v >= 0.0 else "////" for v in drawn])
    axes.use_sticky_edges = False  # leaves room at the left of zero
    axes.plot(np.zeros(is_out.sum()), rows[is_out], "X", color=ALARM, ms=6, transform=_left(axes))
    _name_rows(axes, inference, shown)
    axes.axvline(0.0, color=INK, lw=0.8)
    axes.set(ylim=(len(shown) - 0.4, -0.6))
    axes.set_xlabel("log-likelihood ratio of a demonstration to no constraint [nats]", fontsize=8.5)
    open_sides(axes)
    axes.spines["left"].set_visible(False)
    return written(figure, path)


def _chosen(inference: Inference, hypothesis: int | None) -> int:
    """Return the hypothesis to draw, after checking that there is something to draw."""
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


def _shares(inference: Inference, index: int) -> str:
    """Return how many demonstrations avoid and enter it."""
    counted = inference.is_counted[inference.task_of, index]
    entering = int((inference.entered[:, index] & counted).sum())
    num, avoiding = len(counted), int(counted.sum()) - entering
    parts = [
        f"of {wording.counted(num, 'demonstration')} {avoiding} avoid it",
        f"{entering} enter it" + " (hatched; crosses rule it out)" * bool(entering),
    ]
    if not counted.all():
        parts.append(f"{int((~counted).sum())} start or end too near to count")
    return ", ".join(parts)


def _left(axes: Axes) -> Transform:
    """Return where a cross at zero is drawn: beside the line at zero, among what speaks against."""
    inches = cast(Figure, axes.figure).dpi_scale_trans
    return axes.transData + ScaledTranslation(-7 / 72, 0.0, inches)


def _names(inference: Inference) -> list[str]:
    """Return the names of demonstrations, those that look the same numbered: 'demo (2)'."""
    counts: Counter[str] = Counter()
    names = []
    for demonstration in inference.demonstrations:
        name = wording.cut(demonstration.name, 24)
        counts[name] += 1
        names.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return names


def _name_rows(axes: Axes, inference: Inference, shown: np.ndarray) -> None:
    names = _names(inference)
    axes.set_yticks(np.arange(len(shown)), [names[d] for d in shown])
    for label in axes.get_yticklabels():
        label.set_parse_math(False)
    left_out = len(inference.demonstrations) - len(shown)
    if left_out:
        axes.set_title(f"{left_out} that say no more are not drawn", fontsize=7.5, color=FAINT)
