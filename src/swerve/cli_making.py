"""The commands that make things: demonstrations, and published results anew."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import swerve
from swerve.cli_options import AsJson, Problem, Tasks, open_work, say


def demonstrate(
    problem: Problem,
    /,
    *,
    constraint: int,
    out: Path,
    num: int | None = None,
    tasks: Tasks = None,
    solver: str = "grid",
    seed: int = 0,
) -> None:
    """Make demonstrations that obey one of the hypotheses, by sampling pi_c with the grid solver.

    Args:
      constraint: Index of the hypothesis to obey.
      out: Folder to write demo_000.csv, demo_001.csv, ... and tasks.csv into.
      num: How many, of as many tasks drawn from the MDP. [default: 10, or one for each of --tasks]
      solver: grid, with settings as in 'grid?num_points=81'.
    """
    from swerve.demonstrations import new_files, read_tasks, write_demonstrations
    from swerve.demonstrators.boltzmann import demonstrate as draw
    from swerve.store import check_writable
    from swerve.tasks import draw_tasks

    if tasks is not None and num is not None:
        raise ValueError("give --num or --tasks, not both: there is one demonstration a task")
    if num is not None and num < 1:
        raise ValueError(f"--num: expected at least 1, got {num}")
    check_writable(out)
    job = open_work(problem, None)
    record, forbidden = job.record, job.record.hypotheses.constraint(constraint)
    if tasks is not None:
        rows = read_tasks(tasks, record.space, record.goal_names)
        batch = swerve.Task.stack(list(rows.values()))
        names = [f"demo_{row.removeprefix('demo_')}" for row in rows]
    else:
        batch = draw_tasks(job.problem, num or 10, avoid=[forbidden], seed=seed)
        names = [f"demo_{k:03d}" for k in range(num or 10)]
    new_files(out, names)  # before the work
    made = draw(job.problem, forbidden, batch, names=names, solver=solver, seed=seed, progress=True)
    write_demonstrations(
        out, made, record.space, action_names=record.action_names, goal_names=record.goal_names
    )
    say(f"wrote {len(made)} demonstrations that avoid {forbidden.name} to {out}")


def reproduce(
    name: Literal["gridworld", "human-walk"],
    /,
    *,
    out: Path | None = None,
    data: Path | None = None,
    quick: bool = False,
    as_json: AsJson = False,
) -> None:
    """Regenerate a published result: figures as PNG and SVG, the numbers in them as CSV.

    gridworld: false positives and KL divergence against the number of demonstrations (Scobee and
    Sastry, 2019), and what someone under no constraint enters; one to two minutes.

    human-walk: the obstacle that people in a room walk around, from their tracks; two to three
    minutes. --data names a folder of tracks.csv, with columns t [s], track, x, y
    [m], and room.png, in which free floor is light; room.json tells where the picture lies,
    {"corner": [x, y], "cell": side of a pixel} [m], unless that is [-11, -10] and 0.01.

    Args:
      name: The result.
      out: Folder to write into; files of the same names are replaced. gridworld needs one;
        without one human-walk prints its tables alone.
      data: Golden output, a golden.json, to take demonstrations from and to compare with.
        [default: demonstrations drawn in a world of Swerve's own]; of human-walk, the folder.
      quick: Fewer numbers of demonstrations; of human-walk, wider steps of beta.
      as_json: Print one JSON object; human-walk alone.
    """
    from swerve.store import check_writable

    if data is not None and not data.exists():
        raise FileNotFoundError(f"--data {data}: no such file; check the path")
    if out is not None:
        check_writable(out)
    if name == "human-walk":
        _reproduce_human_walk(data, out, quick, as_json)
    elif out is None or as_json:
        raise ValueError("gridworld: give --out, a folder for its figures and numbers, not --json")
    else:
        _reproduce_gridworld(data, out, quick)


def _reproduce_gridworld(data: Path | None, out: Path, is_quick: bool) -> None:
    from swerve.reproduce import gridworld, gridworld_figures

    result = gridworld.reproduce(data, is_quick=is_quick, progress=True)
    written = gridworld_figures.write(result, out)
    print(gridworld_figures.table(result))
    say(f"wrote {', '.join(path.name for path in written)} to {out}")


def _reproduce_human_walk(
    data: Path | None, out: Path | None, is_quick: bool, as_json: bool
) -> None:
    from swerve.reproduce import human_walk, human_walk_figures

    if data is None or not data.is_dir():
        raise ValueError(f"--data {data}: expected a folder of tracks.csv and room.png")
    result = human_walk.reproduce(data, is_quick=is_quick, progress=True)
    print(json.dumps(human_walk.to_json(result)) if as_json else human_walk_figures.table(result))
    if out is not None:
        written = human_walk_figures.write(result, out)
        say(f"wrote {', '.join(path.name for path in written)} to {out}")
