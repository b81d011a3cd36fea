"""Read people's tracks through a room, and the room's map, from a folder.

    room.png     free floor is light; walls and other places that nobody can enter are dark
    room.json    place of the picture: {"corner": [x, y], "cell": w}, its lower left corner and the
                 side of a pixel [m]; without this file (-11, -10) m and 0.01 m, as in the
                 recordings of the THOR data set
    tracks.csv   columns t [s], track, x, y [m], the samples of a track in the order of time

The end of a track is taken as the goal of the person. A track is used if it goes somewhere, by a
nearly straight way,

    |end - start| > 3 m,   length < 1.6 |end - start|,

and stays 0.2 m from walls, as the middle of a body must.

Shapes: L samples of a track.
"""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.image import imread

from swerve.base.arguments import number_or_nan
from swerve.base.space import StateSpace, Task
from swerve.constraints.base import violates
from swerve.constraints.occupancy import Occupancy
from swerve.demonstrations.checks import check_finite, row_namer
from swerve.demonstrations.demonstration import Demonstration
from swerve.demonstrations.formats import read_table
from swerve.demonstrations.tables import file_content

CORNER, CELL = (-11.0, -10.0), 0.01  # m: lower left corner and pixel of THOR's map
LEAST_DISTANCE = 3.0  # m between the ends of a track
MOST_WINDING = 1.6  # largest length of a track, in units of the distance between its ends
LIGHT = 0.5  # share of white from which a pixel is floor
FEWEST = 2  # least number of tracks: cross-validation compares each track with others
BODY = 0.2  # m between walls and the middle of a person
REASONS: tuple[str, ...] = ("shorter than 3 m", "winding", "less than 0.2 m from walls")


class Room(NamedTuple):
    """The map of a room.

    Attributes:
      picture: the blocked pixels of the picture.
      walls: the blocked pixels and all within 0.2 m of them, where no middle of a body can be.
      floor: [2, 2] (low, high) of x and y of the free floor [m].
    """

    picture: Occupancy
    walls: Occupancy
    floor: np.ndarray


class Tracks(NamedTuple):
    """Tracks of people.

    Attributes:
      used: the tracks to infer from.
      left_out: number of other tracks, by reason.
    """

    used: list[Demonstration]
    left_out: dict[str, int]


def read_room(folder: Path) -> Room:
    """Read the map of a room.

    Raises:
      OSError: if there is no map.
      ValueError: if a file cannot be understood, or the map has no floor.
    """
    path = folder / "room.png"
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file; expected a picture of the room's floor")
    try:
        picture = np.asarray(imread(io.BytesIO(file_content(path)), "png"), float)
    except (SyntaxError, ValueError, OSError) as error:
        raise ValueError(
            f"{path}: expected a PNG picture ({error}); save the map as one"
        ) from error
    grey = picture if picture.ndim == 2 else picture[..., :3].mean(axis=-1)
    blocked = grey[::-1] < LIGHT
    if blocked.all():
        raise ValueError(f"{path}: all pixels are dark; expected free floor to be light")
    corner, cell = _place(folder / "room.json")
    walls = Occupancy("walls", blocked, corner, cell)
    if walls.widened(BODY).blocked.all():
        raise ValueError(f"{path}: no floor wide enough for a body; check the scale in room.json")
    rows, columns = (np.flatnonzero((~blocked).any(axis=axis)) for axis in (1, 0))
    floor = [(low + cell * at[0], low + cell * (at[-1] + 1)) for low, at in
             zip(corner, (columns, rows), strict=True)]  # fmt: skip
    return Room(walls, walls.widened(BODY), np.array(floor))


def _place(path: Path) -> tuple[tuple[float, float], float]:
    """Return the lower left corner of the map and the side of its cells [m].

    Raises:
      ValueError: if the file does not hold them.
    """
    if not path.exists():
        return CORNER, CELL
    expected = 'expected {"corner": [x, y], "cell": side of a pixel}, in metres'
    try:
        data = json.loads(file_content(path))
        (x, y), cell = map(number_or_nan, data["corner"]), number_or_nan(data["cell"])
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise ValueError(f"{path}: {expected}; reading it failed ({error!r})") from error
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(cell) and cell > 0.0):
        raise ValueError(f"{path}: {expected}, finite and cell > 0, got {data}")
    return (x, y), cell


def read_tracks(folder: Path, room: Room) -> Tracks:
    """Read the tracks of a room.

    Raises:
      OSError: if there is no tracks.csv.
      ValueError: if the file cannot be understood, most tracks are not on the floor of the room, or
        too few can be used.
    """
    path = folder / "tracks.csv"
    table = read_table(path, ("t", "track", "x", "y"))
    check_finite(table.values, table.names, row_namer(str(path), table.line_of))
    tracks, times, positions = (table.columns(names) for names in (["track"], ["t"], ["x", "y"]))
    used, left_out = [], dict.fromkeys(REASONS, 0)
    for number in dict.fromkeys(tracks[:, 0].tolist()):
        rows = np.flatnonzero(tracks[:, 0] == number)
        late = np.flatnonzero(np.diff(times[rows, 0]) <= 0.0)
        if len(late):
            raise ValueError(
                f"{row_namer(str(path), table.line_of)(int(rows[late[0] + 1]))}: t does not "
                f"increase within track {number:g}; expected the samples of a track in the order "
                "of their times"
            )
        states = positions[rows]
        reason = _reason(states, room)
        if reason is None:
            used.append(Demonstration(f"track {number:g}", states, Task(states[0], states[-1])))
        else:
            left_out[reason] += 1
    _check(path, used, left_out)
    return Tracks(used, left_out)


def _reason(states: np.ndarray, room: Room) -> str | None:
    """Return the reason to leave a track [L, 2] out; None to use it."""
    distance = math.dist(states[0], states[-1])
    length = np.linalg.norm(np.diff(states, axis=0), axis=1).sum()
    short, winding, blocked = REASONS
    if distance <= LEAST_DISTANCE:
        return short
    if length >= MOST_WINDING * distance:
        return winding
    return blocked if violates(room.walls, states, space(room), True) else None


def space(room: Room) -> StateSpace:
    """Return the positions (x, y) over the floor of a room."""
    return StateSpace(("x", "y"), (), room.floor)


def _check(path: Path, used: list[Any], left_out: dict[str, int]) -> None:
    """Raise ValueError if the tracks are not of this room, or too few."""
    blocked = left_out[REASONS[2]]
    if blocked > len(used):
        raise ValueError(
            f"{path}: {blocked} of {blocked + len(used)} tracks lead through walls or outside "
            "room.png; expected positions in metres in the frame of the picture: place it by a "
            'room.json, {"corner": [x, y], "cell": side of a pixel}'
        )
    if len(used) < FEWEST:
        raise ValueError(
            f"{path}: {len(used)} tracks that can be used, expected at least {FEWEST}; left out: "
            + ", ".join(f"{count} {reason}" for reason, count in left_out.items())
        )
