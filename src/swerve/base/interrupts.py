"""Let Ctrl-C end work at any moment.

Python raises KeyboardInterrupt wherever the main thread is. Inside a callback, such as JAX's own of
the garbage collector, or a destructor, nobody can catch the error: Python prints it, drops it, and
goes on. Here the dropped interrupt comes again a moment later. While results are saved no interrupt
is raised.
"""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

STATUS = 130  # of a command that Ctrl-C has ended: 128 + SIGINT
SOON = 0.05  # s after which a dropped interrupt comes again: the callback is over by then
INSIST = 1.0  # s after which an interrupt comes again that other code has caught and forgotten

_lock = threading.Lock()
_pending: list[None] = []  # an interrupt that is to come again
_expected: list[None] = []  # interrupts that come again, told from new ones
_asked: list[None] = []  # interrupts that were taken since `listen`
_saving: list[None] = []  # blocks of `saving` that are open
_open: list[object] = []  # blocks of `heeded` that are open
_before: list[Any] = []  # what took dropped errors before the first of these


@contextmanager
def heeded() -> Iterator[None]:
    """Raise a KeyboardInterrupt anew that a callback has dropped while the block runs.

    None comes later than the end of the block, also where the block ends by another error.
    """
    block = object()
    try:
        with _lock:
            if not _open:
                _before[:] = [sys.unraisablehook]
                sys.unraisablehook = _take_dropped
            _open.append(block)
        yield
    finally:
        if _close(block):
            raise KeyboardInterrupt


def _close(block: object) -> bool:
    """Close a block of `heeded`, whatever comes meanwhile; return whether an interrupt is due."""
    is_due = False
    while True:
        try:
            with _lock:
                if block in _open:
                    _open.remove(block)
                if not _open:
                    is_due |= bool(_pending)
                    _pending.clear()
                    if sys.unraisablehook is _take_dropped:
                        sys.unraisablehook = _before[0]
            return is_due
        except KeyboardInterrupt:  # such as one that was on its way while the lock was awaited
            is_due = True


@contextmanager
def saving() -> Iterator[None]:
    """Let interrupts wait, in a command, until the block has saved what an interrupt would lose.

    A second Ctrl-C ends the command at once here too.
    """
    num_before = len(_asked)
    _saving.append(None)
    try:
        yield
    finally:
        _saving.pop()
    if len(_asked) > num_before and not _saving:
        raise KeyboardInterrupt


def _take_dropped(dropped: Any) -> None:
    """Ask for a dropped interrupt again; pass any other dropped error on."""
    if isinstance(dropped.exc_value, KeyboardInterrupt):
        _again(SOON)
    else:
        (_before[0] if _before else sys.__unraisablehook__)(dropped)


def _again(seconds: float) -> None:
    """Interrupt the main thread after some time.

    A thread of `threading` would not do: its locks may be held where the interrupt came.
    """
    if not _pending:
        _pending.append(None)
        _thread.start_new_thread(_wait_and_ask, (seconds,))


def _wait_and_ask(seconds: float) -> None:
    time.sleep(seconds)
    with _lock:  # so that `heeded` ends before the interrupt is asked for, or after it has come
        if _pending:
            _pending.clear()
            _expected.append(None)
            # a signal, since `_thread.interrupt_main` wakes no main thread that sleeps
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def take(handler: Callable[[int, Any], None]) -> None:
    """Take SIGINT by a handler, unless it is ignored: a script began the command with &."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, handler)


def listen() -> None:
    """Take SIGINT in a command: KeyboardInterrupt until heeded; a second Ctrl-C ends it at once."""
    take(_interrupt)


def is_asked() -> bool:
    """Return whether Ctrl-C was pressed since `listen`, whatever became of the error."""
    return bool(_asked)


def _interrupt(number: int, frame: Any) -> None:
    if _expected:
        _expected.pop()
    elif _asked:
        os._exit(STATUS)
    _asked.append(None)
    _again(INSIST)
    if not _saving:
        raise KeyboardInterrupt


def leave(number: int = 0, frame: Any = None) -> None:
    """End the process at once, where nothing has begun or everything is done; for `take`."""
    if sys.stderr is not None:  # else it is closed, and 2 may be any file by now
        with suppress(OSError):  # of a log on a full disk
            os.write(2, b"interrupted\n")
    os._exit(STATUS)
