"""What all tests share."""

from __future__ import annotations

import codecs
import os
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import jax
import pytest
from hypothesis import settings
from support.command import CONSTRAINT, ROBOT, Run

from swerve.cli import app
from swerve.cli import demonstrate as demonstrate_command

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

settings.register_profile("swerve", deadline=None)  # no test may fail for being slow
settings.load_profile("swerve")


def pytest_configure(config: pytest.Config) -> None:
    """Give each process its cores; what one test has compiled no other compiles again.

    Most of the time goes into compiling. Threads of XLA spin while they wait, so that processes
    which share cores hold one another up.
    """
    if "PYTEST_XDIST_WORKER" in os.environ and hasattr(os, "sched_setaffinity"):
        worker = int(os.environ["PYTEST_XDIST_WORKER"].removeprefix("gw"))
        cores = sorted(os.sched_getaffinity(0))
        num_workers = int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
        os.sched_setaffinity(0, cores[worker::num_workers] or cores)
    heed_interrupts()
    folder = tempfile.TemporaryDirectory(prefix="swerve-tests-")  # of this run alone
    config.add_cleanup(folder.cleanup)
    Path(folder.name).chmod(0o777)  # see `nobody`
    jax.config.update("jax_compilation_cache_dir", folder.name)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def heed_interrupts() -> None:
    """Let the processes that tests start heed SIGINT, although this one may ignore it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="module")
def no_more_programs_than_a_process_may_have() -> Iterator[None]:
    """Drop what a file has compiled: each program takes memory maps, of which there are 65,530."""
    yield
    jax.clear_caches()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real data beside the repository; in CI its absence is a failure."""
    if not SHARED_DATA.is_dir():
        reason = f"needs the real data, expected in {SHARED_DATA}"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    return SHARED_DATA


@pytest.fixture
def robot(tmp_path: Path) -> str:
    """A user's problem in a file of its own, with a neighbour that it imports."""
    (tmp_path / "robot.py").write_text(ROBOT)
    (tmp_path / "neighbour.py").write_text("MAX_TORQUE = 3.0\n")
    sys.modules.pop("neighbour", None)
    return f"{tmp_path / 'robot.py'}:problem"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run the command in this process; return status, standard output and standard error."""

    def run(*arguments: object) -> tuple[int, str, str]:
        sys.modules.pop("neighbour", None)  # a new process would import it anew
        monkeypatch.setattr(sys, "argv", ["swerve", *map(str, arguments)])
        monkeypatch.setattr(os, "_exit", sys.exit)  # which would end the tests
        try:
            app.main()
            status = 0
        except SystemExit as stop:
            status = stop.code if isinstance(stop.code, int) else 1
        heed_interrupts()  # which an interrupted command ignores while it ends
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run


@pytest.fixture(scope="session")
def demonstrations(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Demonstrations of a constraint, made by the command itself."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "robot.py").write_text(ROBOT)
    (folder / "neighbour.py").write_text("MAX_TORQUE = 3.0\n")
    sys.modules.pop("neighbour", None)
    demonstrate_command.demonstrate(
        f"{folder}/robot.py:problem", constraint=CONSTRAINT, num=4, out=folder / "out"
    )
    return sorted((folder / "out").glob("demo_*.csv"))


@pytest.fixture
def nobody(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, demonstrations: list[Path]
) -> Iterator[None]:
    """Run as a user who may read everything in the temporary folder and write nothing."""
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o555)
    root = tmp_path_factory.getbasetemp().parents[1 if "PYTEST_XDIST_WORKER" in os.environ else 0]
    for folder in (*demonstrations[0].parents, tmp_path):
        if folder.stat().st_uid == os.geteuid() and folder.is_relative_to(root):
            folder.chmod(0o755)
    if os.geteuid() != 0:
        yield
        return
    codecs.lookup("utf-8-sig")  # loaded on demand, from where nobody may not be able to read
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)
