"""Fuzz records of JSON, with checksums that are right again, and texts of settings."""

from __future__ import annotations

import contextlib
import json
import shutil
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from fuzz.mutator import mutated, mutated_json
from fuzz.target import Target, refusing
from support.wrong_contents import write_record

from swerve import ActionBox, Ball, Box, HalfSpace, Occupancy, Polygon, StateAction, windows
from swerve.base import store
from swerve.base.specification import Specification, build
from swerve.base.store import StoreError
from swerve.constraints.base import Union
from swerve.hypotheses.base import ConstraintHypotheses
from swerve.work.folder import Reading, State, WorkFolder
from swerve.work.settings import Settings

STORED = Path(__file__).parents[1] / "data" / "before_packages" / "work"
OTHERS = Settings(solver="grid", seed=0)
TEXT = "pendulum?max_torque=10"


class WorkFolders(Target):
    """Folders whose problem.json is whole and holds something else."""

    name, share = "folder", 3

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.path = folder / "work"
        shutil.copytree(STORED, self.path)
        right = store.read_json(self.path / "problem.json")
        walls = Occupancy("walls", np.eye(3, dtype=bool), (0.0, 0.0), 1.0, ("theta", "omega"))
        box, triangle = Box(omega=(0.0, 1.0)), [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]
        kinds = [
            box,
            walls,
            ActionBox(torque=(0.0, 1.0)),
            Ball(1.0, omega=2.0),
            HalfSpace(1.0, omega=1.0),
            Polygon(triangle, ("theta", "omega")),
            StateAction(box, ActionBox(torque=(0.0, 1.0))),
            Union("both", [box, walls]),
        ]
        shapes, flat = ConstraintHypotheses(kinds), right["record"]["space"] | {"angles": []}
        table = [[2, 1], [[0, 1, -1], [1, 0, 0]], [[0.0], [1.0], [2.0]]]
        changes: list[dict[str, Any]] = [
            {},
            {"space": flat, "hypotheses": shapes.to_json(), "known": [walls.to_json()]},
            {"hypotheses": windows(2, omega=(0.0, 6.0, 3.0)).to_json()},
            {"num_actions": 3, "transitions": table},
        ]
        self.seeds = [right | {"record": right["record"] | change} for change in changes]
        for seed in self.seeds:
            write_record(self.path / "problem.json", seed)
            assert self.opened().state is State.CURRENT

    def opened(self) -> Reading:
        """Return what the folder's record says."""
        return WorkFolder(self.path, TEXT).read()

    def run(self, random: Random) -> None:
        """Open a folder: it is refused by name, or its record and settings can be used."""
        data = random.choice(self.seeds)
        write_record(self.path / "problem.json", self.changed(data, random))
        with refusing(ValueError):
            found = self.opened()
            if found.record is not None:
                assert len(found.record.fingerprint) == 64
                settings = found.settings.completed(OTHERS).filled()
                WorkFolder(self.path, TEXT).read_evidence(settings, found.record)

    @staticmethod
    def changed(data: Any, random: Random) -> Any:
        """Return JSON data with other members, or now and then of another text."""
        if random.random() < 0.1:
            text = json.dumps(data).encode()
            with contextlib.suppress(ValueError, RecursionError):  # seldom is it still JSON
                return json.loads(mutated(text, [text], random))
        return mutated_json(data, random)


class Records(Target):
    """Damaged records of JSON, such as those of a work folder."""

    name, share = "record", 1

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.path = folder / "problem.json"
        self.data = {"problem": "pendulum", "a": [1, 2.5, None], "b": {"c": "é\x1b"}}
        store.write_json(self.path, self.data)
        self.whole = self.path.read_bytes()

    def run(self, random: Random) -> None:
        """Read a damaged record: its checksum tells, or nothing that matters has changed."""
        self.path.write_bytes(mutated(self.whole, [self.whole], random))
        with refusing(StoreError):
            assert store.read_json(self.path) == self.data


class Specifications(Target):
    """Texts of problems and solvers with their parameters."""

    name, share = "specification", 1

    def run(self, random: Random) -> None:
        """Build from a text: parameters are of their types, or the text is refused."""
        seeds = [b"p?a=1&b=2.5&c=x&d=true&e=1,2", b"p?b=1e3", b"p"]
        text = mutated(random.choice(seeds), seeds, random).decode("utf-8", "surrogateescape")
        with refusing(ValueError):
            build(_built, Specification.parse(text), text)


def _built(
    a: int = 1, b: float = 1.0, c: str = "", d: bool = False, e: tuple[float, ...] = ()
) -> None:
    assert type(a) is int
    assert type(b) is float
    assert b == b
    assert type(c) is str
    assert type(d) is bool
    assert all(type(number) is float for number in e)
