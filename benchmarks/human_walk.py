"""Measure how the obstacle found in people's tracks depends on beta, walls and squares.

    python benchmarks/human_walk.py --data DIR [--beta 8.49]

The first pick of `swerve reproduce human-walk` at one beta is made again with one setting changed:
the distance that the middle of a body keeps from walls, the corner that squares are counted from,
the side of squares, or beta. The table gives the distance of the first pick's centre from the
obstacle's, its log-likelihood ratio, and its lead over the best square that does not overlap it.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.table import Table

from swerve import windows
from swerve.problem.problem import Problem
from swerve.reproduce.human_walk.measure import (
    OVERLAP,
    WIDTH,
    answer_at,
    centre,
    problem_of,
    squares,
)
from swerve.reproduce.human_walk.tracks import Room, Tracks, read_room, read_tracks
from swerve.solvers.exact.soft_paths import SoftPaths

OBSTACLE = (0.69, 0.52)  # m: centre of the obstacle in the THOR recordings
WALLS = (0.0, 0.1)  # m from walls; 0.2 unless changed
CORNERS = ((-11.0, -10.0), (-10.92, -9.89), (0.09, 0.09))  # m; (0, 0) unless changed
SIDES = (0.5, 1.0)  # m: side of squares; 0.75 unless changed
BETAS = (0.95, 1.1, 1.5, 2.0)  # in units of the given beta


def problems(room: Room, beta: float) -> Iterator[tuple[str, Problem]]:
    """Yield a name of each change, and the problem with the change."""
    yield "as it is", problem_of(room, beta)
    for distance in WALLS:
        walls = room.picture.widened(distance) if distance else room.picture
        yield f"walls kept off by {distance:g} m", problem_of(room._replace(walls=walls), beta)
    for corner in CORNERS:
        yield f"squares from ({corner[0]:g}, {corner[1]:g})", moved(room, beta, corner, WIDTH)
    for side in SIDES:
        yield f"squares of {side:g} m", moved(room, beta, (0.0, 0.0), side)
    for factor in BETAS:
        yield f"beta {factor * beta:.2f}", problem_of(room, factor * beta)


def moved(room: Room, beta: float, corner: tuple[float, float], side: float) -> Problem:
    """Return the problem with squares of another side, or counted from another corner [m]."""
    axes = []
    for start, (low, high) in zip(corner, room.floor.tolist(), strict=True):
        first = start + side * math.floor((low - start) / side)
        axes.append((first, first + side * math.ceil((high - first) / side), side))
    x, y = axes
    return dataclasses.replace(
        problem_of(room, beta), hypotheses=windows(x=x, y=y, overlap=OVERLAP)
    )


def row(problem: Problem, tracks: Tracks) -> tuple[str, ...]:
    """Return place of the first pick, its distance to the obstacle, its nats and its lead."""
    answer = answer_at(SoftPaths().learn(problem), tracks, most=1)
    if not answer.picks:
        return "none", "", "", ""
    pick, score = answer.picks[0], answer.inference.log_likelihood
    place = centre(squares(problem.hypotheses)[pick.hypothesis])
    lead = math.inf if answer.elsewhere is None else pick.total_gain - score[answer.elsewhere]
    return (
        f"({place[0]:.2f}, {place[1]:.2f})",
        f"{math.dist(place, OBSTACLE):.2f}",
        f"{pick.total_gain:.1f}",
        f"{lead:.1f}",
    )


def main() -> None:
    """Infer with each change and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of tracks.csv, room.png")
    parser.add_argument("--beta", type=float, default=8.49, help="nats a metre")
    arguments = parser.parse_args()
    room = read_room(arguments.data)
    tracks = read_tracks(arguments.data, room)
    table = Table(
        title=f"{len(tracks.used)} tracks, beta {arguments.beta:g} ({os.cpu_count()} cores)"
    )
    for column in ("changed", "first pick [m]", "from the obstacle [m]", "nats", "ahead by [nats]"):
        table.add_column(column.replace("[", r"\["))
    for changed, problem in problems(room, arguments.beta):
        table.add_row(changed, *row(problem, tracks))
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
