"""Fuzz stored files: evidence with wrong contents and right checksums, records, and settings."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from random import Random

import numpy as np
from fuzz.mutator import mutated
from fuzz.target import Target, refusing
from support.synthetic import make_demonstration, make_evidence, make_samples

from swerve import Evidence, infer
from swerve.base import store
from swerve.base.specification import Specification, build
from swerve.base.store import HEADER, StoreError

ODD = (np.nan, np.inf, -np.inf, 1e308, -1e308, -1.0, 0.0, 1e-320, 2.0**63)
KINDS = ("<f4", "<f8", "<i8", "|u1", "|b1", "<U3", "<c16", ">f8")


class EvidenceFiles(Target):
    """Files of evidence: damaged, or well-formed with other contents."""

    name, share = "evidence", 8

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.path = folder / "a.evidence"
        make_evidence(samples=make_samples(20)).save(self.path)
        self.whole = self.path.read_bytes()
        with zipfile.ZipFile(io.BytesIO(self.whole)) as archive:
            self.members = {name: archive.read(name) for name in archive.namelist()}

    def run(self, random: Random) -> None:
        """Read evidence, and infer from it if it is accepted."""
        way = random.randrange(4)
        if way == 0:
            content = mutated(self.whole, [self.whole], random)
        else:
            content = self.packed(dict(self.members), way, random)
        self.path.write_bytes(content)
        with refusing(StoreError):
            evidence = Evidence.load(self.path)
            assert evidence.samples.kept.ndim == 4
            with refusing(ValueError):
                infer(evidence, [make_demonstration(0)])

    def packed(self, members: dict[str, bytes], way: int, random: Random) -> bytes:
        """Return a ZIP file, with right checksums, of changed members."""
        name = HEADER if way == 1 else random.choice(list(members))
        if way == 2 and name != HEADER:
            members[name] = self.array(members[name], random)
        else:
            members[name] = mutated(members[name], list(members.values()), random)
        buffer = io.BytesIO()
        kind = zipfile.ZIP_DEFLATED if random.random() < 0.1 else zipfile.ZIP_STORED
        with zipfile.ZipFile(buffer, "w", kind) as archive:
            for key, data in members.items():
                archive.writestr(key, data)
        return buffer.getvalue()

    @staticmethod
    def array(data: bytes, random: Random) -> bytes:
        """Return an array with other values, another shape or another kind, as a file."""
        values = np.load(io.BytesIO(data)).copy()
        way = random.randrange(4)
        if way == 0 and values.size and values.dtype.kind == "f":
            values.flat[random.randrange(values.size)] = random.choice(ODD)
        elif way == 1:
            values = np.repeat(values, random.randrange(3), axis=random.randrange(values.ndim))
        elif way == 2:
            values = values.astype(random.choice(KINDS), casting="unsafe")
        else:
            values = values[None] if random.random() < 0.5 else values.reshape(-1)
        buffer = io.BytesIO()
        np.save(buffer, values)
        return buffer.getvalue()


class Records(Target):
    """Records of JSON, such as those of a work folder."""

    name, share = "record", 2

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
