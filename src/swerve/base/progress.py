"""Show progress bars with the time left, on standard error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

Advance = Callable[..., None]
"""A function to call with the amount of work done since the last call; `note` shows a text."""


@contextmanager
def progress_bar(description: str, total: float, enabled: bool) -> Iterator[Advance]:
    """Show a bar while the block runs.

    Args:
      description: name of the work, shown before the bar.
      total: amount of work, in any unit.
      enabled: whether to show the bar.

    Yields:
      A function to call with the amount of work done since the last call.
    """
    if not enabled:
        yield lambda amount, note="": None
        return
    from rich.console import Console
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
        TextColumn("{task.description}", table_column=Column(no_wrap=True)),
        BarColumn(bar_width=10, table_column=Column(min_width=10)),
        TaskProgressColumn(table_column=Column(min_width=4, no_wrap=True)),
        TimeElapsedColumn(table_column=Column(min_width=7, no_wrap=True)),
        TextColumn("left", table_column=Column(min_width=4, no_wrap=True)),
        TimeRemainingColumn(table_column=Column(min_width=7, no_wrap=True)),
        TextColumn("{task.fields[note]}", table_column=Column(overflow="fold")),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        job = bar.add_task(description, total=total, note="")

        def advance(amount: float, note: str = "") -> None:
            bar.update(job, advance=amount)
            if note:
                bar.update(job, note=note)

        yield advance
