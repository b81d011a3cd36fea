"""Fuzz the readers of CSV and Parquet: demonstrations and tasks.

What is read agrees with a second reader, which knows nothing but the grammar.
"""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from random import Random

import numpy as np
from fuzz.mutator import mutated
from fuzz.target import Target, refusing
from support.demonstration_files import PLANE, TASKS

from swerve.demonstrations.demonstration import read_demonstrations, read_tasks
from swerve.demonstrations.formats import read_table

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
WORD = re.compile("nan|[+-]?inf(inity)?", re.ASCII | re.IGNORECASE)
NAMES, OPTIONAL = ("x", "y"), ("t", "ax")
MAX_MESSAGE = 2000  # characters: longer messages would not be read
SEEDS = [
    b"x,y\n1,0\n2,0.5\n3,1\n",
    b"t,x,y,ax\n0,1,0,1\n0.5,2,0.5,2\n1,3,1,\n",
    b'y,"note","x"\r\n0,"a, b",1\r\n0.5,"c\nd",2\r\n1,,"3"\r\n',
    b"\xef\xbb\xbfx,y,note\n 1 ,+0,a\n2.0,5e-1,b\n3.,1,c\n\n",
    b"x,y\n" + b"".join(b"%d.25,0.5\n" % (k % 9) for k in range(60)),
    TASKS.encode(),
]


def second_reading(data: bytes) -> tuple[list[str], list[list[float]]] | None:
    """Return the names and rows of numbers in CSV; None where the file must be refused."""
    try:
        text = data.decode("utf-8-sig")
        text = text.replace("\r\n", "\n").replace("\r", "\n")
        rows = [
            row
            for row in csv.reader(io.StringIO(text, newline="\n"))
            if "".join(row).strip() or len(row) > 1
        ]
    except (UnicodeDecodeError, csv.Error):
        return None
    header = [name.strip() for name in rows[0]] if rows else [""]
    header[0] = header[0].lstrip("#").strip()  # as NumPy writes it
    named = [name for name in header if name]
    if not set(NAMES) <= set(header) or len(set(named)) < len(named) or len(rows) < 2:
        return None
    names = [name for name in (*NAMES, *OPTIONAL) if name in header]
    values = []
    for number, row in enumerate(rows[1:], 1):
        if len(row) != len(header):
            return None
        values.append([])
        for name in names:
            cell = row[header.index(name)].strip(" \t")
            if not cell and name in OPTIONAL and number == len(rows) - 1:
                cell = "nan"
            value = float(cell) if NUMBER.fullmatch(cell) or WORD.fullmatch(cell) else None
            if value is None or (np.isinf(value) and NUMBER.fullmatch(cell)):
                return None
            values[-1].append(value)
    return names, values


class Tables(Target):
    """CSV of demonstrations, read as a table and as a demonstration."""

    name, share = "csv", 40

    def run(self, random: Random) -> None:
        """Hold the reader against the second reader."""
        data = mutated(random.choice(SEEDS), SEEDS, random)
        path = self.folder / "demo.csv"
        path.write_bytes(data)
        expected, found = second_reading(data), None
        with refusing(ValueError, most=MAX_MESSAGE):
            found = read_table(path, NAMES, OPTIONAL)
        if expected is None:
            assert found is None, f"read {data!r}"
        else:
            assert found is not None, f"refused {data!r}"
            assert found.names == expected[0]
            np.testing.assert_array_equal(found.values, expected[1])
        with refusing(ValueError):
            (item,) = read_demonstrations(path, PLANE, action_names=["ax"])
            assert np.isfinite(item.states).all()


class TasksFiles(Target):
    """Tasks files in CSV."""

    name, share = "tasks", 16

    def run(self, random: Random) -> None:
        """Read tasks, which are inside the bounds if they are read at all."""
        path = self.folder / "tasks.csv"
        path.write_bytes(mutated(SEEDS[-1], SEEDS, random))
        with refusing(ValueError):
            for name, task in read_tasks(path, PLANE).items():
                assert isinstance(name, str)
                assert (np.abs(np.concatenate(task)) <= 11.0).all()


class ParquetFiles(Target):
    """Parquet of demonstrations: damaged files, and whole ones of random numbers."""

    name, share = "parquet", 4

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.whole = np.random.default_rng(0).uniform(0.1, 1.9, (50, 2))
        self.seeds = [self.encoded(self.whole, **how) for how in (
            {}, {"compression": "uncompressed"}, {"compression": "snappy", "use_pyarrow": False},
            {"row_group_size": 7, "statistics": False},
        )]  # fmt: skip

    @staticmethod
    def encoded(values: np.ndarray, **how: object) -> bytes:
        """Return a Parquet file of numbers, times and texts."""
        import polars as pl

        buffer = io.BytesIO()
        columns = {
            "x": values[:, 0],
            "y": values[:, 1],
            "t": np.arange(len(values)),
            "note": ["a"] * len(values),
        }
        pl.DataFrame(columns).write_parquet(buffer, **how)  # pyright: ignore[reportArgumentType]
        return buffer.getvalue()

    def run(self, random: Random) -> None:
        """Read a damaged file, and now and then a whole one."""
        path = self.folder / "demo.parquet"
        seed = random.choice(self.seeds)
        is_whole = random.random() < 0.05
        path.write_bytes(seed if is_whole else mutated(seed, self.seeds, random))
        if is_whole:
            np.testing.assert_array_equal(read_table(path, NAMES).values, self.whole)
        with refusing(ValueError):
            read_demonstrations(path, PLANE)
