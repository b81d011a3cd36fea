"""Which source files a problem is made of, and their hashes."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.problem_files import SHAPES

import swerve
from swerve.problem.loading import _is_user_source, file_hash, load_problem, source_hashes

PRINT_SOURCES = """
import json, sys
from swerve.problem.loading import load_problem, source_hashes
problem = load_problem(sys.argv[1])
print(json.dumps([source_hashes(problem), problem.record.fingerprint]))
"""


class TestSourceHashes:
    def test_are_those_of_the_file_and_its_neighbours(self, folder: Path) -> None:
        """In a fresh process; of Swerve at most the classes that the MDP is made of."""
        (folder / "unrelated.py").write_text("")
        package = Path(swerve.__file__).parent
        command = [sys.executable, "-c", PRINT_SOURCES, f"{folder}/robot.py:problem"]
        environment = os.environ | {"PYTHONPATH": str(package.parent), "JAX_PLATFORMS": "cpu"}
        run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        found, fingerprint = json.loads(run.stdout)
        assert fingerprint == load_problem(f"{folder}/robot.py:problem").record.fingerprint
        outside = {path for path in found if not Path(path).is_relative_to(package)}
        names = ("robot.py", "helper.py", "shapes.py")
        assert outside == {str(folder.resolve() / name) for name in names}
        within = {str(Path(path).relative_to(package)) for path in found.keys() - outside}
        assert within <= {"problem/mdp.py", "systems/pendulum.py"}
        for path, digest in found.items():
            assert digest == file_hash(Path(path))

    def test_a_changed_neighbour_is_noticed(self, folder: Path) -> None:
        before = source_hashes(load_problem(f"{folder}/robot.py:problem"))
        shapes = str(folder / "shapes.py")
        (folder / "shapes.py").write_text(SHAPES.replace("3)", "4)"))
        cached = source_hashes(load_problem(f"{folder}/robot.py:problem"))
        assert cached[shapes] == before[shapes]  # of the code that was imported, and runs
        for name in ("helper", "shapes"):
            sys.modules.pop(name)
        after = source_hashes(load_problem(f"{folder}/robot.py:problem"))
        assert {path for path in before if before[path] != after[path]} == {shapes}

    def test_are_of_whatever_is_imported(
        self, folder: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A module that the problem does not use is among them, a script is not."""
        problem = load_problem(f"{folder}/robot.py:problem")
        (folder / "unrelated.py").write_text("")
        assert str(folder / "unrelated.py") not in source_hashes(problem)
        monkeypatch.syspath_prepend(folder)
        importlib.import_module("unrelated")
        found = source_hashes(problem)
        assert str(folder / "unrelated.py") in found
        assert not any(path.endswith("__main__.py") for path in found)

    def test_exclude_installed_packages(self, folder: Path) -> None:
        found = source_hashes(load_problem(f"{folder}/robot.py:problem"))
        assert str(folder / "helper.py") in found
        assert not any("site-packages" in path for path in found)
        assert str(Path(json.__file__)) not in found
        assert str(Path(pytest.__file__)) not in found

    def test_of_a_file(self, tmp_path: Path) -> None:
        path = tmp_path / "a.py"
        assert file_hash(path) == file_hash(tmp_path) == "missing"
        path.write_bytes(b"")
        assert file_hash(path).startswith("e3b0c44298fc1c149afbf4c8996fb924")
        empty = file_hash(path)
        path.write_bytes(b"x")
        assert file_hash(path) != empty


@pytest.mark.parametrize(
    "path",
    [
        "/home/me/.local/lib/python3.11/site-packages/jax/core.py",
        "/usr/lib/python3/dist-packages/yaml/nodes.py",
    ],
)
def test_packages_installed_elsewhere_are_no_sources(path: str) -> None:
    assert not _is_user_source(Path(path))
