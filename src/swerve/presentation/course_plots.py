"""Draw how belief moved while a demonstration went on.

    P_t(c) against t, as lines; P_t over the state space, as an animation

Shapes: L states, H hypotheses.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from PIL import Image

from swerve.base import files
from swerve.base.figure_style import FAINT, INK, WIDTH, headed, open_sides, plain, written
from swerve.base.phrases import cut, probability
from swerve.base.space import Task
from swerve.inference.ranking import Ranking
from swerve.monitoring.course import Course
from swerve.presentation import plane as planes
from swerve.presentation.plane_picture import picture
from swerve.presentation.shading import Shading, of_probability

NUM_LINES = 5  # hypotheses with a line of their own: those that were most probable at some time
LEAST_SUM = 0.01  # probability: all other hypotheses have one line if their sum ever exceeds this
STYLES = ("-", "--", "-.", ":", (0, (1, 1)))
COLOURS = ("#5b1a78", "#d55e00", "#0072b2", "#009e73", "#999999")
NUM_FRAMES = 60  # frames of an animation, at most
FRAME, LAST = 100, 2_000  # ms for which each frame, and the last frame, is shown
DPI = 80  # pixels an inch of an animation: small files


def plot_course(course: Course, path: str | Path | None = None, *, width: float = WIDTH) -> Figure:
    """Draw how probable no constraint and the likeliest hypotheses were, against time.

    A cross marks where the demonstration enters a hypothesis. The dots at the right are the belief
    after the demonstration ended. One more line is the sum of all other hypotheses, where it
    exceeds 1 % at some time.

    Args:
      course: result of `swerve.follow`.
      path: a file to write, whose suffix tells the format, or None.
      width: width of the picture [in].

    Raises:
      ValueError: if matplotlib knows no such format, or the picture is too narrow for its text.
    """
    shown = np.argsort(-course.hypotheses.max(axis=0), kind="stable")[:NUM_LINES].tolist()
    header = [
        (f"Belief while {course.demonstration.name} went on", 11.5, INK),
        ("Dots: belief after the end. Crosses: the demonstration enters a hypothesis.", 8.0, FAINT),
    ]
    figure = headed(header, width, 0.45 * width, width)
    axes = figure.add_subplot()
    _draw_line(axes, course, course.none, "no constraint", color=INK, lw=2.0)
    for index, style, colour in zip(shown, STYLES, COLOURS, strict=False):
        _draw_hypothesis(axes, course, index, color=colour, ls=style, lw=1.5)
    others = course.hypotheses.sum(axis=1) - course.hypotheses[:, shown].sum(axis=1)
    if others.max() > LEAST_SUM:
        label = f"all other hypotheses ({course.hypotheses.shape[1] - len(shown)})"
        _draw_line(axes, course, others, label, color=FAINT, ls=(0, (6, 2)), lw=2.0)
    axes.set(ylim=(-0.02, 1.02))
    axes.set_xlabel("time [s]", fontsize=9)
    axes.set_ylabel("posterior probability", fontsize=9)
    open_sides(axes)
    ncols = 2 if width > 6 else 1
    plain(figure.legend(loc="outside lower left", fontsize=8, frameon=False, ncols=ncols))
    return written(figure, path)


def _draw_hypothesis(axes: Axes, course: Course, index: int, **style: Any) -> None:
    """Draw the probability of a hypothesis, with a cross where the demonstration enters it."""
    values = course.hypotheses[:, index]
    name = cut(course.evidence.problem.hypotheses.name(index), 40)
    _draw_line(axes, course, values, f"{index}: {name}", **style)
    if course.entered[-1, index]:
        k = int(course.entered[:, index].argmax())
        axes.plot(course.times[k], values[k], "x", color=style["color"], clip_on=False)


def _draw_line(axes: Axes, course: Course, values: np.ndarray, label: str, **style: Any) -> None:
    """Draw values [L + 1] against time: a line, and a dot for the last value, after the end."""
    [line] = axes.plot(course.times[:-1], values[:-1], label=label, **style)
    axes.plot(course.times[-1], values[-1], "o", color=line.get_color(), ms=5, clip_on=False)


def animate_course(course: Course, path: str | Path, *, width: float = WIDTH) -> None:
    """Write an animation of the posterior over the state space as a demonstration went on.

    Args:
      course: result of `swerve.follow`.
      path: a .gif file.
      width: width of the picture [in].

    Raises:
      ValueError: if the file does not end in .gif, or the picture is too narrow for its text.
    """
    path = Path(path)
    if path.suffix.lower() != ".gif":
        raise ValueError(f"{path}: expected a file that ends in .gif")
    num = len(course.demonstration.states)
    rows = np.unique(np.linspace(0, num, min(NUM_FRAMES, num + 1)).astype(int))
    blank = Ranking.of(course.evidence)
    end = _figure(course, blank, num, width)
    end.draw_without_rendering()  # lays out the axes once, so that they do not move
    places = [axes.get_position(original=True) for axes in end.axes]
    frames = [_frame(_figure(course, blank, k, width), places) for k in rows.tolist()]
    height = max(frame.height for frame in frames)
    padded = [Image.new("RGB", (frame.width, height), "white") for frame in frames]
    for canvas, frame in zip(padded, frames, strict=True):
        canvas.paste(frame, (0, 0))
    durations = [FRAME] * (len(frames) - 1) + [LAST]
    how: dict[str, Any] = {"append_images": padded[1:], "duration": durations, "loop": 0}
    files.replace(path, lambda file: padded[0].save(file, "GIF", save_all=True, **how))


def _frame(figure: Figure, places: list[Bbox]) -> Image.Image:
    """Return a figure as an image, with its axes at given places."""
    figure.set_layout_engine("none")
    for axes, place in zip(figure.axes, places, strict=True):
        axes.set_position(place)
    figure.set_dpi(DPI)
    canvas = cast(FigureCanvasAgg, figure.canvas)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def _figure(course: Course, blank: Ranking, k: int, width: float) -> Figure:
    """Return the picture after state k, or after the end where k = L."""
    values = np.where(np.isneginf(course.log_likelihood[k]), -np.inf, course.hypotheses[k])
    is_best = course.hypotheses[k].max() >= course.none[k]
    best = np.argsort(-values, kind="stable")[:1]
    shading = Shading(
        values,
        of_probability(),
        "posterior probability",
        best if np.isfinite(values[best]).all() else best[:0],
        ("most probable" if is_best else "most probable of the hypotheses", ""),
        lambda index: probability(course.hypotheses[k, index], 0.0),
        is_set=False,
        none=(course.none[k], "no constraint"),
    )
    at = "at the end" if k == len(course.demonstration.states) else f"{course.times[k]:.2f} s"
    none = probability(course.none[k], 0.0)
    header = [(f"{course.demonstration.name}, {at}: no constraint {none}", 11.5, INK)]
    whole = planes.Path(course.demonstration.states, course.demonstration.times)
    return picture(_so_far(course, blank, k), shading, header, width, also=[whole])


def _so_far(course: Course, blank: Ranking, k: int) -> Ranking:
    """Return a ranking that holds the demonstration up to state k, only to be drawn.

    Args:
      course: result of `swerve.follow`.
      blank: the ranking without demonstrations.
      k: a state, or L for the end.
    """
    whole, upto = course.demonstration, min(k + 1, len(course.demonstration.states))
    times = None if whole.times is None else whole.times[:upto]
    part = dataclasses.replace(whole, states=whole.states[:upto], times=times, actions=None)
    number = course.evidence.match(Task(whole.task.start, whole.task.goal))
    return dataclasses.replace(
        blank,
        demonstrations=(part,),
        task_of=np.array([number]),
        entered=course.entered[k : k + 1],
    )
