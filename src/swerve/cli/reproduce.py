"""The command that regenerates published results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

from swerve.cli.options import AsJson, say

WORK = "work"  # folder in --out of what takes long


def reproduce(
    name: Literal["car", "double-pendulum", "gridworld", "human-walk", "pendulum"],
    /,
    *,
    out: Path | None = None,
    data: Path | None = None,
    quick: bool = False,
    seed: int = 0,
    as_json: AsJson = False,
) -> None:
    """Regenerate a published result: figures as PNG and SVG, their numbers as CSV, tables.

    pendulum: the rank of the true constraint against the number of demonstrations, by Swerve and
    by those it is compared with (Stocking et al., 2022, figures 2 and 3); an hour or two. --data
    names a folder of demo_*.csv and tasks.csv of others who avoided cell 55. Needs the extra
    'control'.

    car: which region of the track human-like drivers avoid, by single drives and while they last
    (figure 4); a quarter of an hour.

    double-pendulum: the same as for the pendulum in four dimensions, by networks and by tables of
    cells (Stocking et al., 2021); some ten minutes. Needs the extra 'control'.

    gridworld: false positives and KL divergence against the number of demonstrations (Scobee and
    Sastry, 2019), and what someone under no constraint enters; one to two minutes.

    human-walk: the obstacle that people in a room walk around, from their tracks; two to three
    minutes. --data names a folder of tracks.csv, with columns t [s], track, x, y
    [m], and room.png, in which free floor is light; room.json tells where the picture lies,
    {"corner": [x, y], "cell": side of a pixel} [m], unless that is [-11, -10] and 0.01.

    What the first three take long for is kept in a folder 'work' in --out: the same command goes on
    from there.

    Args:
      name: The result.
      out: Folder to write into; files of the same names are replaced. Without one human-walk
        prints its tables alone; the others need it.
      data: Data of others, as told above; of gridworld golden output, a golden.json, to take
        demonstrations from and to compare with.
        [default: what this project makes itself]
      quick: A small version, in some two minutes.
      seed: Of everything random.
      as_json: Print one JSON object; human-walk alone.
    """
    from swerve.base.arguments import whole_number
    from swerve.base.store import check_writable

    seed = whole_number(seed, "--seed", 0)

    if data is not None and not data.exists():
        raise FileNotFoundError(f"--data {data}: no such file; check the path")
    if out is not None:
        check_writable(out)
    if name == "human-walk":
        _human_walk(data, out, quick, seed, as_json)
    elif out is None or as_json:
        raise ValueError(f"{name}: give --out, a folder for its figures and numbers, not --json")
    elif name == "gridworld":
        _gridworld(data, out, quick, seed)
    elif name == "pendulum":
        _pendulum(data, out, quick, seed)
    elif data is not None:
        raise ValueError(f"{name}: there are no data of others to take: leave --data out")
    elif name == "car":
        _car(out, quick, seed)
    else:
        _double_pendulum(out, quick, seed)


def _car(out: Path, is_quick: bool, seed: int) -> None:
    from swerve.reproduce.car import figures as car_figures
    from swerve.reproduce.car import measure as car

    result = car.reproduce(out / WORK / "car", is_quick=is_quick, seed=seed, progress=True)
    print(car_figures.text(result))
    _write(out, car_figures, result)


def _double_pendulum(out: Path, is_quick: bool, seed: int) -> None:
    from swerve.reproduce.double_pendulum import (
        figures as double_pendulum_figures,
    )
    from swerve.reproduce.double_pendulum import (
        measure as double_pendulum,
    )

    result = double_pendulum.reproduce(
        out / WORK / "double-pendulum", is_quick=is_quick, seed=seed, progress=True
    )
    print(double_pendulum_figures.text(result))
    _write(out, double_pendulum_figures, result)


def _pendulum(data: Path | None, out: Path, is_quick: bool, seed: int) -> None:
    from swerve.reproduce.pendulum import figures as pendulum_figures
    from swerve.reproduce.pendulum import measure as pendulum

    result = pendulum.reproduce(
        out / WORK / "pendulum", data, is_quick=is_quick, seed=seed, progress=True
    )
    print(pendulum_figures.text(result))
    _write(out, pendulum_figures, result)


def _gridworld(data: Path | None, out: Path, is_quick: bool, seed: int) -> None:
    from swerve.reproduce.gridworld import figures as gridworld_figures
    from swerve.reproduce.gridworld import measure as gridworld

    result = gridworld.reproduce(data, is_quick=is_quick, seed=seed, progress=True)
    print(gridworld_figures.text(result))
    _write(out, gridworld_figures, result)


def _human_walk(
    data: Path | None, out: Path | None, is_quick: bool, seed: int, as_json: bool
) -> None:
    from swerve.reproduce.human_walk import figures as human_walk_figures
    from swerve.reproduce.human_walk import measure as human_walk

    if data is None or not data.is_dir():
        raise ValueError(f"--data {data}: expected a folder of tracks.csv and room.png")
    result = human_walk.reproduce(data, is_quick=is_quick, seed=seed, progress=True)
    print(json.dumps(human_walk.to_json(result)) if as_json else human_walk_figures.text(result))
    if out is not None:
        _write(out, human_walk_figures, result)


def _write(out: Path, figures: Any, result: Any) -> None:
    """Write what a module of figures makes of a result."""
    from swerve.reproduce.files import write

    written = write(out, figures.parts(result), figures.tables(result))
    say(f"wrote {', '.join(path.name for path in written)} to {out}")
    prefix = figures.__name__.rpartition(".")[2].removesuffix("figures")
    others = sorted(path.name for path in out.glob(f"{prefix}*") if path not in written)
    if others:
        say(f"in {out}, but not of this run: {', '.join(others)}")
