from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

import swerve
from swerve.problem import Problem
from swerve.specification import (
    SHIPPED,
    Specification,
    build,
    canonical_problem,
    file_hash,
    load_problem,
    source_hashes,
)

ROBOT = """
import swerve
from helper import cells

class Cart(swerve.Pendulum):
    '''A class of the user's own.'''

problem = swerve.Problem(Cart(max_torque=2.0, num_steps=3), cells, beta=0.5)
number = 3

def make(max_torque: float, num_steps: int = 3, cells_only: bool = False) -> object:
    if cells_only:
        return cells
    return swerve.Problem(Cart(max_torque, num_steps=num_steps), cells)
"""
HELPER = """
import shapes
cells = shapes.cells()
"""
SHAPES = """
import swerve

def cells():
    return swerve.grid(theta=(0.0, 6.0, 3))
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a problem that imports its neighbours; imports are forgotten afterwards."""
    for name, text in {"robot": ROBOT, "helper": HELPER, "shapes": SHAPES}.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    known = set(sys.modules)
    yield tmp_path
    for name, module in list(sys.modules.items()):
        if name not in known and str(tmp_path) in str(getattr(module, "__file__", "")):
            del sys.modules[name]


class TestParse:
    @pytest.mark.parametrize(
        ("text", "target", "parameters"),
        [
            ("pendulum", "pendulum", ()),
            ("pendulum?", "pendulum", ()),
            ("pendulum?b=2&a=1", "pendulum", (("a", "1"), ("b", "2"))),
            ("a/b.py:name?x=c=d", "a/b.py:name", (("x", "c=d"),)),
            ("ppo?layers=64 64", "ppo", (("layers", "64 64"),)),
        ],
    )
    def test_splits_target_and_parameters(self, text: str, target: str, parameters) -> None:
        assert Specification.parse(text) == Specification(target, parameters)

    @pytest.mark.parametrize(
        ("query", "item"), [("a", "'a'"), ("a=", "'a='"), ("=1", "'=1'"), ("a=1&", "''")]
    )
    def test_what_is_no_assignment_is_refused(self, query: str, item: str) -> None:
        with pytest.raises(ValueError, match=rf"pendulum\?.*: expected name=value .*, got {item}"):
            Specification.parse(f"pendulum?{query}")

    def test_a_parameter_twice_is_refused(self) -> None:
        with pytest.raises(ValueError, match="parameter 'a' is given twice"):
            Specification.parse("pendulum?a=1&b=2&a=1")


class TestCanonical:
    def test_order_and_ways_to_write_numbers_do_not_matter(self) -> None:
        texts = [
            f"pendulum?{a}&{b}"
            for values in (("beta=0.67", "max_torque=10"), ("max_torque=1e1", "beta=.670"))
            for a, b in itertools.permutations(values)
        ]
        assert {str(Specification.parse(text)) for text in texts} == {
            "pendulum?beta=0.67&max_torque=10.0"
        }

    @given(number=st.floats(allow_nan=False, allow_infinity=False))
    def test_numbers_keep_their_value(self, number) -> None:
        text = str(Specification.parse(f"p?a={number!r}"))
        assert float(text.removeprefix("p?a=")) == number
        assert str(Specification.parse(text)) == text

    @pytest.mark.parametrize("value", ["uniform", "True", "nan", "-inf", "64 64", "1,5"])
    def test_other_texts_stay_as_they_are(self, value: str) -> None:
        assert str(Specification.parse(f"p?a={value}")) == f"p?a={value}"

    def test_different_values_stay_different(self) -> None:
        texts = ["p?a=1", "p?a=2", "p?b=1", "q?a=1", "p", "p?a=x", "p?a=1&b=1"]
        assert len({canonical_problem(text) for text in texts}) == len(texts)

    def test_files_are_absolute(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        (tmp_path / "sub").mkdir()
        expected = f"{tmp_path.resolve()}/robot.py:make?a=1.0"
        for path in ("robot.py", "./robot.py", "sub/../robot.py", f"{tmp_path}/robot.py"):
            assert canonical_problem(f"{path}:make?a=1") == expected
        assert canonical_problem("package.robot:make?a=1") == "package.robot:make?a=1.0"


class TestBuild:
    @staticmethod
    def call(function: Callable[..., object], query: str) -> object:
        text = f"p?{query}"
        return build(function, Specification.parse(text), text)

    def test_converts_to_the_types_of_the_signature(self) -> None:
        def function(
            a: int,
            b: float,
            c: bool,
            d: str,
            e: float | None = None,
            f: int | float = 0,
            g: Literal["x", "y"] = "x",
        ) -> tuple:
            return a, b, c, d, e, f, g

        found = self.call(function, "a=2e6&b=3&c=True&d=007&e=1e-3&f=2.5&g=y")
        assert found == (2_000_000, 3.0, True, "007", 0.001, 2.5, "y")
        assert isinstance(found, tuple)
        assert [type(x) for x in found] == [int, float, bool, str, float, float, str]
        assert self.call(function, "a=-1&b=inf&c=false&d=x") == (
            -1,
            float("inf"),
            False,
            "x",
            None,
            0,
            "x",
        )

    def test_builds_classes(self) -> None:
        found = self.call(Specification, "target=a&parameters=b")
        assert found == Specification("a", "b")  # type: ignore[arg-type]

    @pytest.mark.parametrize(
        ("query", "message"),
        [
            ("a=2.5", "parameter 'a': expected int, got '2.5'"),
            ("a=ten", "parameter 'a': expected int, got 'ten'"),
            ("a=inf", "parameter 'a': expected int, got 'inf'"),
            ("b=ten", "parameter 'b': expected float, got 'ten'"),
            ("c=1", "parameter 'c': expected bool, got '1'"),
            ("e=none", "parameter 'e': expected int or float, got 'none'"),
        ],
    )
    def test_values_of_another_type_are_refused(self, query: str, message: str) -> None:
        def function(a: int = 0, b: float = 0.0, c: bool = True, e: int | float = 0) -> None: ...

        with pytest.raises(ValueError, match=rf"'p\?{query}': {message}"):
            self.call(function, query)

    def test_unknown_and_missing_parameters_are_refused(self) -> None:
        def function(alpha: int, gamma: str, beta: float = 0.0) -> None: ...

        with pytest.raises(ValueError, match="no parameter 'x'; there are alpha, gamma, beta"):
            self.call(function, "x=1")
        with pytest.raises(ValueError, match="parameters without a value: alpha, gamma"):
            self.call(function, "beta=1")
        with pytest.raises(ValueError, match="no parameter 'x'; there are none"):
            self.call(lambda: None, "x=1")

    def test_an_error_of_the_function_itself_comes_through(self) -> None:
        def function(a: int) -> None:
            raise ValueError("a is odd")

        with pytest.raises(ValueError, match=r"^a is odd$"):
            self.call(function, "a=1")


class TestLoadProblem:
    def test_a_shipped_name_with_parameters(self) -> None:
        problem = load_problem("pendulum?max_torque=10&beta=0.25&between_states=false")
        assert isinstance(problem, Problem)
        assert isinstance(problem.mdp, swerve.Pendulum)
        assert problem.mdp.max_torque == 10.0
        assert problem.beta == 0.25
        assert problem.between_states is False
        assert len(problem.hypotheses) == 100

    def test_every_shipped_name_loads(self) -> None:
        for name in SHIPPED:
            assert isinstance(load_problem(name), Problem)

    def test_a_problem_in_a_file(self, folder: Path) -> None:
        problem = load_problem(f"{folder}/robot.py:problem")
        assert type(problem.mdp).__name__ == "Cart"
        assert len(problem.hypotheses) == 3
        assert problem.beta == 0.5

    def test_a_function_in_a_file(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(folder)
        problem = load_problem("robot.py:make?max_torque=4&num_steps=7")
        assert (problem.mdp.max_torque, problem.mdp.num_steps) == (4.0, 7)

    def test_an_edited_file_is_read_again(self, folder: Path) -> None:
        first = load_problem(f"{folder}/robot.py:problem")
        (folder / "robot.py").write_text(ROBOT.replace("beta=0.5", "beta=0.75"))
        second = load_problem(f"{folder}/robot.py:problem")
        assert (first.beta, second.beta) == (0.5, 0.75)
        assert first.record.fingerprint != second.record.fingerprint

    def test_a_file_may_be_called_like_an_installed_module(self, folder: Path) -> None:
        (folder / "numpy.py").write_text(SHAPES + "import robot\nproblem = robot.problem\n")
        import numpy as np

        assert isinstance(load_problem(f"{folder}/numpy.py:problem"), Problem)
        assert sys.modules["numpy"] is np

    def test_a_module(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.syspath_prepend(str(folder))
        package = folder / "garage"
        package.mkdir()
        (package / "__init__.py").write_text("")
        (package / "cart.py").write_text(ROBOT)
        assert load_problem("garage.cart:problem").beta == 0.5
        assert load_problem("garage.cart:make?max_torque=3").mdp.max_torque == 3.0

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("walker9", "'walker9' is no problem: expected one of pendulum, .*a path/to/file.py:"),
            ("pendulum?gravity=9", "no parameter 'gravity'; there are max_torque, beta, measure"),
            ("pendulum?beta=hot", "parameter 'beta': expected float, got 'hot'"),
            ("pendulum?max_torque=-1", "pendulum: expected max_torque > 0, got -1.0"),
            ("pendulum?measure=equal", "measure: expected one of"),
            ("missing/file.py:problem", r"missing/file\.py: no such file"),
            ("no_such_package.cart:problem", "'no_such_.*': No module named 'no_such_package'"),
        ],
    )
    def test_what_there_is_not_is_refused(self, text: str, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            load_problem(text)

    @pytest.mark.parametrize(
        ("name", "message"),
        [
            ("cart", r"robot\.py defines no 'cart'"),
            ("number", "expected a swerve.Problem, got int"),
            ("make", "parameters without a value: max_torque"),
            ("make?max_torque=1&cells_only=true", "expected a swerve.Problem, got GridHypotheses"),
            ("problem?beta=1", "'problem' is a Problem, not a function .* takes no parameters"),
        ],
    )
    def test_what_is_no_problem_is_refused(self, folder: Path, name: str, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            load_problem(f"{folder}/robot.py:{name}")


PRINT_SOURCES = """
import json, sys
from swerve.specification import load_problem, source_hashes
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
        assert within <= {"mdp.py", "systems/pendulum.py"}
        for path, digest in found.items():
            assert digest == file_hash(Path(path))

    def test_a_changed_neighbour_is_noticed(self, folder: Path) -> None:
        before = source_hashes(load_problem(f"{folder}/robot.py:problem"))
        shapes = str(folder / "shapes.py")
        (folder / "shapes.py").write_text(SHAPES.replace("3)", "4)"))
        after = source_hashes(load_problem(f"{folder}/robot.py:problem"))
        assert {path for path in before if before[path] != after[path]} == {shapes}

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
