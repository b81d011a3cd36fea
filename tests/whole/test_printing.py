"""Texts of others, such as names in files, are no commands to a terminal, a page or a picture."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command import Run
from support.demonstration_files import PLANE, save
from support.synthetic import TASKS, make_evidence, make_record

from swerve import Demonstration, Task, infer
from swerve.base.phrases import cut, shown, shown_lines, some_names
from swerve.base.progress import progress_bar
from swerve.base.space import TWO_PI, StateSpace
from swerve.constraints.boxes import Box
from swerve.demonstrations.demonstration import read_demonstrations
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.presentation import plots

ODD = "\x1b]0;owned\x07\x9b31m\x7f\r\u202e\u2028\u2066\u200b\ufeff[red]<b>&$\\frac$ $x$"
COMMANDS = "\x1b\x07\x9b\x7f\r\u202e\u2028\u2066\u200b\ufeff"


def is_plain(text: str) -> bool:
    return not any(letter in COMMANDS for letter in text)


@pytest.mark.parametrize(
    "letter",
    ["\x00", "\x07", "\x08", "\t", "\n", "\r", "\x1b", "\x7f", "\x80", "\x9b", "\xad", "\u061c",
     "\u200b", "\u200e", "\u200f", "\u2028", "\u2029", "\u202a", "\u202e", "\u2066", "\u2069",
     "\ufeff", "\ud800", "\U000e0041"],
)  # fmt: skip
def test_control_characters_are_escaped(letter: str) -> None:
    escaped = ascii(letter)[1:-1]
    assert shown(f"a{letter}b") == f"a{escaped}b"
    assert shown_lines(f"a{letter}b\nc") == ("a\nb\nc" if letter == "\n" else f"a{escaped}b\nc")


@pytest.mark.parametrize(
    "text", ["", "a b", "x < 1 & y", "é 日本 ±θ", "a\u202fb\xa0c", "\U0001f600"]
)
def test_other_characters_stay(text: str) -> None:
    assert shown(text) == text


def test_names_in_sentences_are_escaped() -> None:
    assert is_plain(cut(ODD, 99))
    assert is_plain(some_names([ODD, "b"]))


@pytest.fixture
def odd() -> Any:
    """An inference in which every name is odd."""
    space = StateSpace((ODD, "x" + ODD), (ODD,), np.array([[0.0, TWO_PI], [0.0, 10.0]]))
    boxes = [Box(**{ODD: (k / 2.0, k / 2.0 + 0.5)}) for k in range(12)]
    record = make_record(
        name=ODD, space=space, goal_names=space.names, hypotheses=ConstraintHypotheses(boxes)
    )
    start, goal = TASKS.start[0], TASKS.goal[0]
    states = np.repeat(start[None], 5, axis=0)
    return infer(make_evidence(record), [Demonstration(ODD, states, Task(start, goal))])


def test_no_name_is_a_command_in_a_picture_a_page_or_a_table(odd: Any, tmp_path: Path) -> None:
    """Nor a formula in a picture: half a formula would end the drawing."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a glyph that is missing
        odd.report(tmp_path / "page.html")
        for draw in (plots.plot_inference, plots.plot_posterior, plots.plot_ranking):
            draw(odd, tmp_path / "picture.svg")
            assert is_plain((tmp_path / "picture.svg").read_text())
        plots.plot_contributions(odd, path=tmp_path / "picture.svg")
    page = (tmp_path / "page.html").read_text()
    assert is_plain(page)
    assert "<b>" not in page
    for text in (odd.headline, odd.belief, odd.table()):
        assert is_plain(text), text


def test_the_command_prints_no_commands(run: Run, robot: str, tmp_path: Path) -> None:
    path = save(tmp_path / "demo_\x1b[31m.csv", f"\x1b]0;owned\x07th{ODD}eta,omega\n1,2\n2,3\n")
    status, _, err = run("infer", robot, path)
    assert status == 1
    assert is_plain(err)
    assert r"found \x1b]0;owned\x07th" in err
    assert r"demo_\x1b[31m.csv: no column theta" in err


def test_a_line_break_in_a_header_makes_no_line(tmp_path: Path) -> None:
    path = save(tmp_path / "demo.csv", '"x\nswerve: error: forged",y\n1,2\n')
    with pytest.raises(ValueError, match=r"found x swerve: error: forged, y$") as raised:
        read_demonstrations(path, PLANE)
    assert "\n" not in str(raised.value)


def test_progress_shows_no_commands(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("swerve.base.progress.FIRST_LINE", 0.0)
    monkeypatch.setenv("TERM", "xterm")
    for is_terminal in (False, True):
        monkeypatch.setattr(sys.stderr, "isatty", lambda answer=is_terminal: answer)
        with progress_bar("work" + ODD, 2.0, True) as advance:
            advance(1.0, ODD)
        err = capsys.readouterr().err
        assert "owned" in err
        assert "[red]" in err
        assert not any(letter in COMMANDS[1:4] + COMMANDS[5:] for letter in err)
        assert "\x1b]" not in err
