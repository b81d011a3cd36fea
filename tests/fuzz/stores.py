"""Fuzz stored results: damaged files, and files with wrong contents and right checksums."""

from __future__ import annotations

import abc
import io
import json
import runpy
import zipfile
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from fuzz.mutator import mutated, mutated_json
from fuzz.target import Target, refusing
from support.synthetic import make_demonstration, make_evidence, make_samples

from swerve import PPO, Evidence, Foresight, infer, load_nominal
from swerve.base.store import HEADER, StoreError
from swerve.problem.problem import Problem
from swerve.solvers.trained.run import Run

STORED = Path(__file__).parents[1] / "data" / "before_packages"
ODD = (np.nan, np.inf, -np.inf, 1e308, -1e308, -1.0, 0.0, 1e-320, 2.0**63)
KINDS = ("<f4", "<f8", "<i8", "|u1", "|b1", "<U3", "<c16", ">f8")


def members_of(content: bytes) -> dict[str, bytes]:
    """Return the members of a stored file by their names."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


class StoredFiles(Target):
    """Stored files of one kind: damaged, or well-formed with other contents.

    Args:
      folder: empty folder to write the inputs to.
      seeds: contents of files that are right.
    """

    def __init__(self, folder: Path, seeds: list[bytes]) -> None:
        super().__init__(folder)
        self.path = folder / "a.stored"
        self.seeds = seeds

    @abc.abstractmethod
    def use(self, number: int) -> None:
        """Read the file, made of the seed of this number, and use what is read.

        Raises:
          ValueError: if the file is refused.
        """
        ...

    def run(self, random: Random) -> None:
        """Change a file, and use it if it is accepted."""
        number, way = random.randrange(len(self.seeds)), random.randrange(4)
        seed = self.seeds[number]
        whole = mutated(seed, self.seeds, random) if way == 0 else packed(seed, way, random)
        self.path.write_bytes(whole)
        self.use(number)


def packed(seed: bytes, way: int, random: Random) -> bytes:
    """Return a ZIP file, with right checksums, of changed members: the header (1), an array (2)."""
    members = members_of(seed)
    name = HEADER if way == 1 else random.choice(list(members))
    if name == HEADER and random.random() < 0.5:
        changed = mutated_json(json.loads(members[HEADER]), random)
        members[HEADER] = json.dumps(changed).encode()
    elif way == 2 and name != HEADER:
        members[name] = array(members[name], random)
    else:
        members[name] = mutated(members[name], list(members.values()), random)
    buffer = io.BytesIO()
    kind = zipfile.ZIP_DEFLATED if random.random() < 0.1 else zipfile.ZIP_STORED
    with zipfile.ZipFile(buffer, "w", kind) as archive:
        for key, data in members.items():
            archive.writestr(key, data)
    return buffer.getvalue()


def array(data: bytes, random: Random) -> bytes:
    """Return an array with other values, another shape or another kind, as a file."""
    values = np.load(io.BytesIO(data)).copy()
    way = random.randrange(4)
    if way == 0 and values.size and values.dtype.kind == "f":
        values.flat[random.randrange(values.size)] = random.choice(ODD)
    elif way == 1 and values.ndim:
        values = np.repeat(values, random.randrange(3), axis=random.randrange(values.ndim))
    elif way == 2:
        values = values.astype(random.choice(KINDS), casting="unsafe")
    else:
        values = values[None] if random.random() < 0.5 else values.reshape(-1)
    buffer = io.BytesIO()
    np.save(buffer, values)
    return buffer.getvalue()


class EvidenceFiles(StoredFiles):
    """Files of evidence."""

    name, share = "evidence", 7

    def __init__(self, folder: Path) -> None:
        path = folder / "a.stored"
        make_evidence(samples=make_samples(20)).save(path)
        super().__init__(folder, [path.read_bytes()])

    def use(self, number: int) -> None:
        """Read evidence, and infer from it."""
        with refusing(StoreError):
            evidence = Evidence.load(self.path)
            assert evidence.samples.kept.ndim == 4
            with refusing(ValueError):
                infer(evidence, [make_demonstration(0)])


class NominalFiles(StoredFiles):
    """Nominal distributions: of solvers that train, and of those that store their settings."""

    name, share = "nominal", 1
    solvers = ("ppo", "soft-value", "grid", "discrete", "tabular", "soft-paths", "enumeration")

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, [(STORED / f"{x}.nominal").read_bytes() for x in self.solvers])
        made = runpy.run_path(str(STORED / "problems.py"))
        self.problems: list[Problem] = [made["problem_of"](name) for name in self.solvers]

    def use(self, number: int) -> None:
        """Read a nominal distribution of the problem."""
        with refusing(StoreError):
            nominal = load_nominal(self.path, self.problems[number])
            assert nominal.problem is self.problems[number]
            assert all(array.dtype.kind in "biuf" for array in nominal.arrays().values())


class ForesightFiles(StoredFiles):
    """What a monitor needs besides the evidence."""

    name, share = "foresight", 1

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, [(STORED / "grid.foresight").read_bytes()])
        self.record = Evidence.load(STORED / "grid.evidence").problem

    def use(self, number: int) -> None:
        """Read a foresight, and foresee by it."""
        with refusing(StoreError):
            foresight = Foresight.load(self.path, self.record)
            for goal in foresight.goals:
                found = foresight.towards(goal)(np.zeros(2), 0)
                assert found.shape == (len(self.record.hypotheses),)
                assert (found <= 0.0).all(), found


class CheckpointFiles(StoredFiles):
    """Training that has not finished."""

    name, share = "checkpoint", 1

    def __init__(self, folder: Path) -> None:
        made: dict[str, Any] = runpy.run_path(str(STORED / "problems.py"))
        self.problem, self.task = made["problem_of"]("ppo"), made["task_of"]("ppo")
        self.solver = PPO(**made["SMALL"])
        self.trainer = self.solver.trainer(self.problem, 0)
        self.path = folder / "a.stored"
        run = self.begin()
        run._checkpoint.save(run._arrays() | {"history": np.ones((1, 6))})
        super().__init__(folder, [self.path.read_bytes()])

    def begin(self) -> Run:
        """Return a run that goes on from the file, if there is one."""
        return Run(self.solver, self.trainer, self.problem, self.task, 0, self.path)

    def use(self, number: int) -> None:
        """Take up a checkpoint."""
        with refusing(ValueError):
            run = self.begin()
            assert 0 <= run.num_done <= self.solver.num_chunks
