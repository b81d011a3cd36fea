"""Belief along a demonstration: what a monitor says state by state, and its pictures."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from matplotlib.layout_engine import ConstrainedLayoutEngine
from PIL import Image
from support.monitors import Known, make_monitor
from support.synthetic import make_demonstration, make_evidence

from swerve import Course, Demonstration, Monitor, animate_course, follow, infer, plot_course


def moving(num_states: int = 30) -> Demonstration:
    """A demonstration that goes through cell 2 half way."""
    made = make_demonstration(0, "demo", num_states=num_states)
    made.states[num_states // 2 :, 1] = 7.0
    times = np.linspace(0.0, 0.4, num_states)
    return dataclasses.replace(made, times=times)


@pytest.fixture
def course() -> Course:
    return follow(make_monitor(), moving())


def test_is_what_the_monitor_says_and_ends_where_infer_ends(course: Course) -> None:
    monitor, demonstration = make_monitor(), moving()
    assert demonstration.times is not None
    for k, state in enumerate(demonstration.states):
        belief = monitor.observe(state, float(demonstration.times[k]))
        assert course.none[k] == belief.none
        np.testing.assert_array_equal(course.hypotheses[k], belief.hypotheses)
        np.testing.assert_array_equal(np.isneginf(course.log_likelihood[k]), belief.struck_out)
    result = infer(make_evidence(), [demonstration])
    np.testing.assert_allclose(course.none[-1], result.posterior.none, atol=1e-6)
    np.testing.assert_allclose(course.hypotheses[-1], result.posterior.hypotheses, atol=1e-6)
    np.testing.assert_array_equal(course.entered[-1], result.entered[0])
    assert course.entered[:, 2].argmax() == 15
    assert course.times[0] == 0.0
    assert course.times[-1] == course.times[-2] == pytest.approx(0.4)


def test_times_are_the_models_steps_where_none_are_known() -> None:
    course = follow(make_monitor(), make_demonstration(0))
    np.testing.assert_allclose(course.times, [0.0, 0.1, 0.2, 0.3, 0.4, 0.4])


def test_it_shows_itself_in_one_line(course: Course) -> None:
    assert repr(course) == "<Course of demo: 30 states>"


def test_a_monitor_that_has_seen_states_is_refused() -> None:
    evidence = make_evidence()
    monitor = Monitor(evidence, moving().task, Known(evidence))
    follow(monitor, moving())
    with pytest.raises(ValueError, match="monitor: expected one that has seen no state yet"):
        follow(monitor, moving())


class TestPicture:
    def test_lines_are_the_probabilities(self, course: Course, tmp_path: Path) -> None:
        figure = plot_course(course, tmp_path / "course.png")
        lines = {line.get_label(): line for line in figure.axes[0].lines}
        np.testing.assert_allclose(
            np.asarray(lines["no constraint"].get_ydata(), float), course.none[:-1]
        )
        best = int(course.hypotheses.max(axis=0).argmax())
        [label] = [str(name) for name in lines if str(name).startswith(f"{best}: ")]
        np.testing.assert_allclose(
            np.asarray(lines[label].get_ydata(), float), course.hypotheses[:-1, best]
        )
        assert imread(tmp_path / "course.png").std() > 0.02

    def test_what_has_no_line_of_its_own_is_one_line(self, course: Course) -> None:
        axes = plot_course(course).axes[0]
        [line] = [x for x in axes.lines if x.get_label() == "all other hypotheses (7)"]
        shown = [x for x in axes.lines if len(np.asarray(x.get_xydata())) > 1]
        assert len(shown) == 7
        total = sum(np.asarray(x.get_ydata(), float) for x in shown)
        np.testing.assert_allclose(total, 1.0)
        assert np.asarray(line.get_ydata(), float).max() > 0.01
        few = course._replace(hypotheses=course.hypotheses * (np.arange(12) < 5))
        labels = [str(x.get_label()) for x in plot_course(few).axes[0].lines]
        assert not [label for label in labels if "other" in label]

    def test_crosses_lie_on_their_line(self, course: Course) -> None:
        likely = np.tile(np.where(np.arange(12) == 2, 0.5, 0.01), (31, 1))
        likely[15:, 2] = 0.2  # entered there, and tolerated
        axes = plot_course(course._replace(hypotheses=likely)).axes[0]
        crosses = [np.asarray(x.get_xydata()) for x in axes.lines if x.get_marker() == "x"]
        assert any(np.allclose(cross, [[course.times[15], 0.2]]) for cross in crosses)

    def test_animation_shows_the_demonstration_grow(self, course: Course, tmp_path: Path) -> None:
        path = tmp_path / "course.gif"
        animate_course(course, path, width=5.0)
        with Image.open(path) as made:
            assert getattr(made, "n_frames", 1) > 3
            first = np.asarray(made.convert("RGB"), float)
            made.seek(made.n_frames - 1)  # pyright: ignore[reportAttributeAccessIssue]
            last = np.asarray(made.convert("RGB"), float)
        assert np.abs(first - last).mean() > 0.5

    def test_animation_is_laid_out_once(self, course: Course, tmp_path: Path, monkeypatch) -> None:
        """What is around the axes stays where it is, and a frame does not wait for it."""
        laid_out, execute = [], ConstrainedLayoutEngine.execute
        monkeypatch.setattr(
            ConstrainedLayoutEngine,
            "execute",
            lambda engine, figure: (laid_out.append(figure), execute(engine, figure))[1],
        )
        animate_course(course, tmp_path / "course.gif", width=5.0)
        assert len(laid_out) == 1

    def test_animations_are_gifs(self, course: Course, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match=r"course.mp4: expected a file that ends in .gif"):
            animate_course(course, tmp_path / "course.mp4")
        assert not list(tmp_path.iterdir())
