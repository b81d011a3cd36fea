"""Progress where standard error is no terminal: lines now and then, by a clock of the tests."""

from __future__ import annotations

import io
import itertools
import re
import sys
import time

import pytest

from swerve.base import progress
from swerve.base.progress import Lines, progress_bar


class Clock:
    """A clock that stands still until it is told to move."""

    def __init__(self) -> None:
        self.now = 1_000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def said() -> list[str]:
    return []


def work(clock: Clock, said: list[str], total: float = 100.0) -> Lines:
    return Lines("sampling", total, said.append, clock)


def test_a_line_says_the_share_the_time_left_and_what_is_known(
    clock: Clock, said: list[str]
) -> None:
    lines = work(clock, said)
    clock.now += 20.0
    lines.advance(40.0, "KL 0.31")
    assert said == ["sampling: 40 % done after 20 s, about 30 s left; KL 0.31"]
    clock.now += 20.0
    lines.advance(59.9)
    assert said[1:] == ["sampling: 99 % done after 40 s, about 0 s left; KL 0.31"]
    clock.now += 10.0
    lines.advance(0.1)
    assert said[2:] == ["sampling: 100 % done after 50 s; KL 0.31"]
    clock.now += 100.0
    lines.end()
    assert said[3:] == ["sampling: done in 2 min"]


def test_lines_come_without_an_advance_and_say_no_time_left(clock: Clock, said: list[str]) -> None:
    lines = work(clock, said)
    clock.now += 5.0
    lines.write_if_due()
    assert said == ["sampling: 0 % done after 5 s"]


def test_work_that_is_soon_over_says_nothing(clock: Clock, said: list[str]) -> None:
    lines = work(clock, said)
    for _ in range(10):
        clock.now += 0.49
        lines.advance(10.0)
    lines.end()
    assert said == []


def test_lines_are_seconds_apart_and_further_in_hours_of_work(
    clock: Clock, said: list[str]
) -> None:
    lines, at = work(clock, said, total=7_200.0), []
    for _ in range(7_200):
        clock.now += 1.0
        before = len(said)
        lines.advance(1.0)
        if len(said) > before:
            at.append(clock.now - 1_000.0)
    assert at[:4] == [5.0, 15.0, 25.0, 35.0]
    assert min(b - a for a, b in itertools.pairwise(at)) == 10.0
    assert len(at) < 70
    assert said[-1] == "sampling: 91 % done after 1.8 h, about 11 min left"


def test_what_was_done_before_says_nothing_of_the_speed(clock: Clock, said: list[str]) -> None:
    """A training that goes on from half of its steps."""
    lines = work(clock, said)
    lines.advance(50.0)
    clock.now += 10.0
    lines.advance(10.0)
    assert said == ["sampling: 60 % done after 10 s, about 40 s left"]


def test_work_of_no_amount(clock: Clock, said: list[str]) -> None:
    lines = work(clock, said, total=0.0)
    clock.now += 60.0
    lines.advance(0.0)
    assert said == ["sampling: 100 % done after 60 s"]


def broken() -> None:
    with progress_bar("resolving", 3, enabled=True):
        time.sleep(0.05)
        raise ValueError("broken")


def test_a_long_step_is_not_silent(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The lines are those of a thread; an error ends them without a word."""
    for name in ("FIRST_LINE", "LINE_INTERVAL", "HEARTBEAT"):
        monkeypatch.setattr(progress, name, 0.01)
    with progress_bar("resolving", 3, enabled=True):
        until, early = time.monotonic() + 20.0, ""
        while not early and time.monotonic() < until:
            time.sleep(0.01)
            early = capsys.readouterr().err
    out, late = capsys.readouterr()
    first, *_, last = (early + late).splitlines()
    assert out == ""
    assert re.fullmatch(r"resolving: 0 % done after \d+ s", first)
    assert re.fullmatch(r"resolving: done in \d+ s", last)
    with pytest.raises(ValueError, match="broken"):
        broken()
    assert "done in" not in capsys.readouterr().err
    with progress_bar("resolving", 3, enabled=False) as advance:
        time.sleep(0.05)
        advance(1.0, note="not shown")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("kind", ["closed", "none"])
def test_a_log_that_was_closed_stops_no_work(
    kind: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With 2>&- there is none from the start."""
    monkeypatch.setattr(progress, "FIRST_LINE", 0.0)
    closed = io.StringIO()
    closed.close()
    with monkeypatch.context() as log:
        if kind == "none":
            log.setattr(sys, "stderr", None)
        with progress_bar("resolving", 2, enabled=True) as advance:
            if kind == "closed":
                log.setattr(sys, "stderr", closed)
            advance(1.0)
            advance(1.0)
    assert capsys.readouterr().out == ""


def test_a_terminal_gets_a_bar(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(progress, "FIRST_LINE", 0.0)
    with progress_bar("training", 4.0, enabled=True) as advance:
        advance(4.0, note="KL 0.2")
    err = capsys.readouterr().err
    assert "━" in err
    assert "100%" in err
    assert "KL 0.2" in err
    assert "% done after" not in err


@pytest.mark.parametrize("name", ["FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"])
def test_a_log_gets_lines_where_colours_are_asked_for(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(name, "1")
    monkeypatch.setattr(progress, "FIRST_LINE", 0.0)
    with progress_bar("training", 4.0, enabled=True) as advance:
        advance(4.0)
    err = capsys.readouterr().err
    assert err.startswith("training: 100 % done after 0 s\n")
    assert "━" not in err
    assert "\x1b" not in err


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        *((0.2, "0 s"), (99.4, "99 s"), (99.6, "2 min"), (5_940.0, "99 min")),
        *((6_000.0, "1.7 h"), (360_000.0, "100.0 h")),
    ],
)
def test_durations(seconds: float, text: str) -> None:
    assert progress.duration(seconds) == text
