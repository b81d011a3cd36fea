"""Inferences to plot, and what a plot shows."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from support.synthetic import TASKS, make_demonstration, make_evidence, make_record

from swerve.answer import Inference, infer
from swerve.base.space import TWO_PI, Task
from swerve.constraints.boxes import Box
from swerve.demonstrations.demonstration import Demonstration
from swerve.hypotheses.base import HypothesisSet
from swerve.hypotheses.grid import grid

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
