"""Ctrl-C that a callback drops comes again, in the main thread."""

from __future__ import annotations

import gc
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from swerve.base import interrupts
from swerve.base.interrupts import heeded
from swerve.base.progress import progress_bar


class Dropping:
    """Its destructor is interrupted: Python prints the error and goes on."""

    def __del__(self) -> None:
        raise KeyboardInterrupt


def wait_for_interrupt(seconds: float = 20.0) -> None:
    """Go on for a while, as a run that does not know."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        time.sleep(0.01)


@pytest.fixture(autouse=True)
def default_handler() -> Any:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    hook = sys.unraisablehook
    yield
    assert sys.unraisablehook is hook
    signal.signal(signal.SIGINT, before)


def dropped_by_destructor() -> None:
    Dropping()


def dropped_by_collector() -> None:
    def interrupted(phase: str, info: dict[str, int]) -> None:
        raise KeyboardInterrupt

    gc.callbacks.append(interrupted)
    try:
        gc.collect()
    finally:
        gc.callbacks.remove(interrupted)


@pytest.mark.parametrize("drop", [dropped_by_destructor, dropped_by_collector])
def test_a_dropped_interrupt_comes_again(drop: Any, capsys: pytest.CaptureFixture[str]) -> None:
    def work(seconds: float) -> None:
        with heeded():
            drop()
            wait_for_interrupt(seconds)

    for seconds in (20.0, 0.0):  # it comes soon, or at the end of the block, and never later
        began = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            work(seconds)
        assert time.monotonic() - began < 19.0
    wait_for_interrupt(0.2)
    assert capsys.readouterr().err == ""


def test_one_that_is_on_its_way_comes_before_the_block_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kill, has_begun, is_over = signal.pthread_kill, threading.Event(), threading.Event()
    came: list[str] = []

    def kill_late(thread: int, number: int) -> None:
        has_begun.set()
        is_over.wait(0.5)
        kill(thread, number)

    monkeypatch.setattr(signal, "pthread_kill", kill_late)
    try:
        try:
            with heeded():
                Dropping()
                has_begun.wait(20.0)
        except KeyboardInterrupt:
            came.append("in time")
        is_over.set()
        wait_for_interrupt(0.2)
    except KeyboardInterrupt:
        came.append("later")
    assert came == ["in time"]


class InterruptedLock:
    """Stands in for the lock: Ctrl-C comes as it is awaited at the end of the block."""

    def __init__(self) -> None:
        self.num_awaited = 0

    def __enter__(self) -> None:
        self.num_awaited += 1
        if self.num_awaited == 2:
            raise KeyboardInterrupt

    def __exit__(self, *_: object) -> None:
        pass


def test_one_at_the_end_of_the_block_outdoes_another_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def work(error: type[Exception] | None) -> None:
        with heeded():
            if error is not None:
                raise error

    for error in (None, ValueError):
        monkeypatch.setattr(interrupts, "_lock", InterruptedLock())
        with pytest.raises(KeyboardInterrupt):
            work(error)
    monkeypatch.undo()


def test_a_dropped_one_outdoes_another_error() -> None:
    def work() -> None:
        with heeded():
            Dropping()
            raise ValueError

    with pytest.raises(KeyboardInterrupt):
        work()


def test_long_work_of_the_library_heeds_it() -> None:
    def work() -> None:
        with progress_bar("work", 1.0, False):
            Dropping()
            wait_for_interrupt()

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        work()
    assert time.monotonic() - began < 19.0


def test_other_dropped_errors_are_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    taken = []
    monkeypatch.setattr(sys, "unraisablehook", taken.append)

    class Failing:
        def __del__(self) -> None:
            raise OverflowError("too much")

    hook = sys.unraisablehook
    with heeded(), heeded():
        Failing()
        assert [type(error.exc_value) for error in taken] == [OverflowError]
    assert sys.unraisablehook is hook
    monkeypatch.undo()


COMMAND = """
import sys, time
from swerve.base.interrupts import listen
from swerve.cli import app

def command():
    try:
        print("go", flush=True)
        time.sleep(60)
    except KeyboardInterrupt:
        {caught}

app.app.command(command)
listen()
sys.argv = ["swerve", "command"]
app.main()
"""


@pytest.mark.parametrize(
    ("caught", "twice"),
    [
        ("raise", False),
        ("time.sleep(60)", False),  # the interrupt is forgotten: it comes again
        ("raise ImportError('half a module')", False),
        ("print('no', flush=True); command()", True),  # nothing helps: the second ends it
    ],
)
def test_a_command_ends_with_130_in_one_line(caught: str, twice: bool) -> None:
    code = COMMAND.format(caught=caught)
    pipe: Any = subprocess.PIPE
    run = subprocess.Popen([sys.executable, "-c", code], stdout=pipe, stderr=pipe, text=True)
    with run:
        assert run.stdout is not None
        assert run.stdout.readline() == "go\n"
        run.send_signal(signal.SIGINT)
        if twice:
            assert run.stdout.readline() == "no\n"
            assert run.stdout.readline() == "go\n"
            run.send_signal(signal.SIGINT)
        _, errors = run.communicate(timeout=30)
    assert run.returncode == 130
    assert errors == ("" if twice else "interrupted\n")


def test_without_standard_error_nothing_is_written_into_another_file() -> None:
    """Which may have its number by then."""
    code = (
        "import os, tempfile; from swerve.base.interrupts import leave\n"
        "file = tempfile.TemporaryFile()\n"
        "os.dup2(file.fileno(), 2); print('go', flush=True)\n"
        "os._exit = lambda status: print(status, os.fstat(2).st_size)\n"
        "leave()\n"
    )
    command = ["sh", "-c", 'exec "$0" -c "$1" 2>&-', sys.executable, code]
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True, timeout=30)
    assert done.stdout == "go\n130 0\n"


SAVING = """
import sys, time
from pathlib import Path
from swerve.base import interrupts
from swerve.base.files import replace
from swerve.cli import app

def write_slowly(file):
    print("saving", flush=True)
    time.sleep({seconds})
    file.write(b"all of it")

def command():
    try:
        print("go", flush=True)
        time.sleep({work})
    finally:
        replace(Path({path!r}), write_slowly)
    time.sleep(60)

interrupts.INSIST = 0.1
app.app.command(command)
interrupts.listen()
sys.argv = ["swerve", "command"]
app.main()
"""


@pytest.mark.parametrize(
    ("work", "seconds", "moments", "is_kept"),
    [
        (60, 0.5, ("go",), True),  # it comes again while the file is written
        (0, 0.5, ("saving",), True),  # the first one waits too
        (60, 60, ("go", "saving"), False),  # a second one does not
    ],
)
def test_an_interrupt_waits_while_results_are_saved(
    work: float, seconds: float, moments: tuple[str, ...], is_kept: bool, tmp_path: Path
) -> None:
    path = tmp_path / "kept"
    code = SAVING.format(work=work, seconds=seconds, path=str(path))
    pipe: Any = subprocess.PIPE
    run = subprocess.Popen([sys.executable, "-c", code], stdout=pipe, stderr=pipe, text=True)
    with run:
        assert run.stdout is not None
        for line in ("go", "saving"):
            assert run.stdout.readline() == f"{line}\n"
            if line in moments:
                run.send_signal(signal.SIGINT)
        _, errors = run.communicate(timeout=30)
    assert run.returncode == 130
    assert errors == ("interrupted\n" if is_kept else "")
    assert path.exists() == is_kept


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
def test_a_process_whose_log_is_full_ends_all_the_same() -> None:
    code = "import time; from swerve.base.interrupts import leave, take; take(leave)\n"
    code += "print('ready', flush=True); time.sleep(60.0)\n"
    with Path("/dev/full").open("w") as full:
        run = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=full)
    with run:
        assert run.stdout is not None
        run.stdout.readline()
        run.send_signal(signal.SIGINT)
        assert run.wait(timeout=30) == interrupts.STATUS
