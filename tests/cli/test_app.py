"""The command as a whole: how it starts, ends and reads options."""

from __future__ import annotations

import inspect
import subprocess
import sys
from pathlib import Path

import pytest
from support.command import Run

import swerve
from swerve.cli import app as cli

PENDULUM = Path(swerve.__file__).parent / "data" / "pendulum" / "demo_000.csv"


def test_a_reader_that_stops_early_is_no_error(robot: str) -> None:
    command = [sys.executable, "-m", "swerve", "demonstrate", "--help"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    process.wait(timeout=60)
    assert "Broken pipe" not in process.stderr.read()
    process.stderr.close()


def test_a_closed_standard_error_puts_no_messages_on_the_output(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    status, out, _ = run("infer", "pendulum", "--seed", -1)
    assert (status, out) == (1, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
def test_a_log_on_a_full_disk_loses_no_result(tmp_path: Path) -> None:
    """The result comes, though no line of progress and no warning can be written."""
    command = [sys.executable, "-m", "swerve", "infer", "pendulum", str(PENDULUM)]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*command, "--solver", "grid?num_points=21", "--samples", "100", "--no-resolve"],
            stdout=subprocess.PIPE, stderr=full, text=True, check=False, timeout=300,
        )  # fmt: skip
    assert done.returncode == 0
    assert "rank  index" in done.stdout
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*command, "--seed", "-1"], stdout=full, stderr=full, check=False, timeout=60
        )
    assert done.returncode == 1


def test_importing_swerve_loads_nothing_heavy() -> None:
    code = (
        "import sys, swerve\n"
        "heavy = {'numpy', 'jax', 'equinox', 'scipy', 'polars', 'matplotlib', 'rich', 'cyclopts'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
        "assert set(swerve.__all__) <= set(dir(swerve))\n"
        "for name in swerve.__all__: getattr(swerve, name)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_unknown_attribute() -> None:
    import swerve

    with pytest.raises(AttributeError, match="has no attribute 'infur'"):
        swerve.infur  # noqa: B018


@pytest.mark.parametrize("command", ["infer pendulum a.csv", "watch pendulum --work w"])
def test_options_of_judging_are_arguments_of_infer_and_of_a_monitor(command: str) -> None:
    words = f"{command} --prior-none 0.25 --tolerance 0.1"
    words += " --margin.theta 0.05 --margin.omega 0.2 --clearance 0.3"
    _, bound, _ = cli.app.parse_args(words.split())
    margin = {"theta": 0.05, "omega": 0.2}
    judged = {"prior": 0.25, "tolerance": 0.1, "margin": margin, "clearance": 0.3}
    assert vars(bound.arguments["judged"]) == judged
    for accepts in (swerve.infer, swerve.Monitor):
        assert set(judged) <= set(inspect.signature(accepts).parameters)


@pytest.mark.parametrize("number", ["0_5", "0x1", "1e400", "nan", "inf", "\u0661", "0,5", " 1"])
@pytest.mark.parametrize("option", ["--prior-none", "--margin.theta", "--clearance", "--samples"])
def test_numbers_are_decimal_numbers(option: str, number: str, run: Run) -> None:
    status, out, said = run("infer", "pendulum", option, number)
    assert (status, out) == (2, "")
    assert said.startswith(f"swerve: error: Invalid value for {option}: expected a ")
    assert said.count("\n") == 1


def test_whole_numbers_may_have_an_exponent() -> None:
    _, bound, _ = cli.app.parse_args(["infer", "pendulum", "--samples", "2e4", "--seed", "7"])
    assert (bound.arguments["how"].samples, bound.arguments["how"].seed) == (20_000, 7)
