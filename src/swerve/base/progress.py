"""Show the progress of long work on standard error: a bar on a terminal, else a line now and then.

A log, a pipe or a file holds lines such as

    sampling: 40 % done after 20 s, about 30 s left

which come also while a single step lasts long, so that no work is silent.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING

from swerve.base.interrupts import heeded
from swerve.base.phrases import duration, shown

if TYPE_CHECKING:
    from rich.console import Console

FIRST_LINE = 5.0  # s of work before its first line: most work is over by then
LINE_INTERVAL = 10.0  # s between two lines at least
LINE_SHARE = 0.1  # of the time so far, between two lines at least: hours of work fill no log
HEARTBEAT = 1.0  # s between two looks at whether a line is due
AT_ONCE = 1.0  # s: what is done by then was done before, and says nothing of the speed

Advance = Callable[..., None]
"""A function to call with the amount of work done since the last call; `note` shows a text."""


class Lines:
    """Lines of text on the progress of one piece of work.

    Args:
      description: name of the work, with which each line begins.
      total: amount of work, in any unit.
      write: called with each line.
      clock: returns the time [s].
    """

    def __init__(
        self,
        description: str,
        total: float,
        write: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._description, self._total = description, total
        self._write, self._clock = write, clock
        self._began = clock()
        self._due = self._began + FIRST_LINE
        self._done = self._done_before = 0.0
        self._note = ""
        self._has_written = False
        self._lock = threading.Lock()  # `advance` and the heartbeat are of two threads

    def advance(self, amount: float, note: str = "") -> None:
        """Add an amount of work that is done, and write a line if one is due."""
        with self._lock:
            self._done += amount
            self._note = note or self._note
            if self._clock() - self._began < AT_ONCE:
                self._done_before = self._done
        self.write_if_due()

    def write_if_due(self) -> None:
        """Write a line if the last one is long enough ago."""
        with self._lock:
            now = self._clock()
            if now < self._due:
                return
            self._due = now + max(LINE_INTERVAL, LINE_SHARE * (now - self._began))
            self._has_written = True
            self._write(self._line(now - self._began))

    def _line(self, elapsed: float) -> str:
        """Return the line after so many seconds."""
        share = min(self._done / self._total, 1.0) if self._total else 1.0
        text = f"{self._description}: {int(100.0 * share)} % done after {duration(elapsed)}"
        new = self._done - self._done_before
        if new > 0.0 and share < 1.0:
            text += f", about {duration(elapsed * (self._total - self._done) / new)} left"
        return f"{text}; {self._note}" if self._note else text

    def end(self) -> None:
        """Write how long the work took, if any line was written before."""
        if self._has_written:
            self._write(f"{self._description}: done in {duration(self._clock() - self._began)}")


@contextmanager
def progress_bar(description: str, total: float, enabled: bool) -> Iterator[Advance]:
    """Show a bar, or lines where standard error is no terminal, while the block runs.

    Ctrl-C is heeded inside the block, wherever it comes.

    Args:
      description: name of the work, shown before the bar.
      total: amount of work, in any unit.
      enabled: whether to show progress.

    Yields:
      A function to call with the amount of work done since the last call.
    """
    with heeded(), _shown(description, total) if enabled else _silence() as advance:
        yield advance


def _shown(description: str, total: float) -> AbstractContextManager[Advance]:
    """Return a bar, or lines."""
    from rich.console import Console

    console = Console(stderr=True)
    is_terminal = console.is_interactive and console.file.isatty()  # FORCE_COLOR makes none
    is_live = is_terminal or console.is_jupyter
    return _bar(description, total, console) if is_live else _lines(description, total)


def _silence() -> AbstractContextManager[Advance]:
    """Return a block without progress."""
    return contextlib.nullcontext(lambda amount, note="": None)


@contextmanager
def _lines(description: str, total: float) -> Iterator[Advance]:
    """Write lines while the block runs, and how long it took unless it raised an error."""
    lines, is_over = Lines(description, total, _say), threading.Event()

    def beat() -> None:
        while not is_over.wait(HEARTBEAT):
            lines.write_if_due()

    heart = threading.Thread(target=beat, name="swerve-progress", daemon=True)
    heart.start()
    try:
        yield lines.advance
    finally:
        is_over.set()
        heart.join()
    lines.end()


def _say(text: str) -> None:
    if sys.stderr is None:  # closed, as by 2>&-
        return
    with contextlib.suppress(OSError, ValueError):  # a closed log stops no work
        sys.stderr.write(f"{shown(text)}\n")
        sys.stderr.flush()


@contextmanager
def _bar(description: str, total: float, console: Console) -> Iterator[Advance]:
    """Show a bar on a terminal while the block runs."""
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.table import Column

    columns = (
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True)),
        BarColumn(bar_width=10, table_column=Column(min_width=10)),
        TaskProgressColumn(table_column=Column(min_width=4, no_wrap=True)),
        TimeElapsedColumn(table_column=Column(min_width=7, no_wrap=True)),
        TextColumn("left", table_column=Column(min_width=4, no_wrap=True)),
        TimeRemainingColumn(table_column=Column(min_width=7, no_wrap=True)),
        TextColumn("{task.fields[note]}", markup=False, table_column=Column(overflow="fold")),
    )
    with Progress(*columns, console=console) as bar:
        job = bar.add_task(shown(description), total=total, note="")

        def advance(amount: float, note: str = "") -> None:
            bar.update(job, advance=amount)
            if note:
                bar.update(job, note=shown(note))

        yield advance
