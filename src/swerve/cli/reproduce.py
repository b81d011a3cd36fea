"""The command that regenerates published results: `swerve reproduce`."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from swerve.cli.options import AsJson, say, tell

WORK = "work"  # folder in --out that keeps slow results
KEEP_WORK = ("car", "double-pendulum", "pendulum")  # results with slow parts, which are kept
TAKE_DATA = ("gridworld", "human-walk", "pendulum")  # results that data of others can go into

OutFolder = Annotated[
    Path | None,
    Parameter(
        help="Folder to write into; files of the same names are replaced. Without a folder "
        "human-walk prints its tables alone; the other results need a folder."
    ),
]
OthersData = Annotated[
    Path | None,
    Parameter(
        help="Data of others, as described above. For gridworld: golden output, a golden.json, to "
        "take demonstrations from and to compare with. [default: what this project makes itself]"
    ),
]


def reproduce(
    name: Literal["car", "double-pendulum", "gridworld", "human-walk", "pendulum"],
    /,
    *,
    out: OutFolder = None,
    data: OthersData = None,
    quick: bool = False,
    seed: int = 0,
    as_json: AsJson = False,
) -> None:
    """Regenerate a published result: figures as PNG and SVG, their numbers as CSV, tables.

    pendulum: the rank of the true constraint against the number of demonstrations, by Swerve and
    by the methods it is compared with (Stocking et al., 2022, figures 2 and 3); an hour or two.
    --data names a folder of demo_*.csv and tasks.csv of other demonstrators, who avoided cell 55.
    Needs the extra 'control'.

    car: the region of the track that human-like drivers avoid, from single drives and while each
    drive lasts (figure 4); a quarter of an hour.

    double-pendulum: the same as for the pendulum in four dimensions, by networks and by tables of
    cells (Stocking et al., 2021); some ten minutes. Needs the extra 'control'.

    gridworld: false positives and KL divergence against the number of demonstrations (Scobee and
    Sastry, 2019), and the cells that an unconstrained demonstrator enters; one to two minutes.

    human-walk: the obstacle that people in a room walk around, from their tracks; two to three
    minutes. --data names a folder of tracks.csv, with columns t [s], track, x, y [m], and room.png,
    in which free floor is light. room.json says where the picture lies, as {"corner": [x, y],
    "cell": side of a pixel} [m]; without room.json these are [-11, -10] and 0.01.

    The first three keep slow results in a folder 'work' in --out: the same command goes on from
    there.

    Args:
      name: The result.
      quick: A small version, in some two minutes.
      seed: Of everything random.
      as_json: Print one JSON object; human-walk alone.
    """
    _check(name, out, data, seed, as_json)
    package = name.replace("-", "_")
    measure = importlib.import_module(f"swerve.reproduce.{package}.measure")
    figures = importlib.import_module(f"swerve.reproduce.{package}.figures")
    arguments = _arguments(name, out, data)
    result = measure.reproduce(*arguments, is_quick=quick, seed=seed, progress=True)
    tell(json.dumps(measure.to_json(result)) if as_json else figures.text(result))
    if out is not None:
        _write(out, package, figures, result)


def _check(name: str, out: Path | None, data: Path | None, seed: int, as_json: bool) -> None:
    """Make sure, before the work, that options go together and files are where they should be."""
    from swerve.base.arguments import seed_number
    from swerve.base.files import check_writable

    seed_number(seed, "--seed")
    if data is not None and not data.exists():
        raise FileNotFoundError(f"--data {data}: no such file; check the path")
    if out is not None:
        check_writable(out)
    if name == "human-walk":
        if data is None or not data.is_dir():
            raise ValueError(f"--data {data}: expected a folder of tracks.csv and room.png")
    elif out is None or as_json:
        raise ValueError(f"{name}: give --out, a folder for its figures and numbers, not --json")
    elif data is not None and name not in TAKE_DATA:
        raise ValueError(f"{name}: there are no data of others to take: leave --data out")


def _arguments(name: str, out: Path | None, data: Path | None) -> list[Path | None]:
    """Return the positional arguments of a result's `measure.reproduce`."""
    folder = [out / WORK / name] if out is not None and name in KEEP_WORK else []
    return [*folder, *([data] if name in TAKE_DATA else [])]


def _write(out: Path, package: str, figures: Any, result: Any) -> None:
    """Write the figures and tables of a result; name files that another run has left.

    Args:
      out: folder to write into.
      package: name of the result's package, with which the names of its files begin.
      figures: the module of the result's figures.
      result: what `measure.reproduce` returned.
    """
    from swerve.reproduce.files import write

    written = write(out, figures.parts(result), figures.tables(result))
    say(f"wrote {', '.join(path.name for path in written)} to {out}")
    others = sorted(path.name for path in out.glob(f"{package}_*") if path not in written)
    if others:
        say(f"in {out}, but not of this run: {', '.join(others)}")
