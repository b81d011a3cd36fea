from __future__ import annotations

import functools
import importlib
import itertools
import json
import os
import re
import subprocess
import sys
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import swerve
from swerve.problem.loading import (
    SHIPPED,
    Specification,
    build,
    canonical_problem,
    file_hash,
    load_problem,
    source_hashes,
)
from swerve.problem.problem import Problem

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


HINTED = {
    "hinted_base": """
from __future__ import annotations
import dataclasses
from typing import TYPE_CHECKING
if TYPE_CHECKING:
    from nowhere import Unknown
Length = float

@dataclasses.dataclass
class Base:
    a: Length | None = None
    b: int = 1
    c: Unknown = 0.5
    d: Unknown | None = None
""",
    "hinted_robot": """
from __future__ import annotations
import dataclasses
from typing import TYPE_CHECKING
from hinted_base import Base
if TYPE_CHECKING:
    from nowhere import Unknown
Extent = float

@dataclasses.dataclass
class Made(Base):
    e: Unknown = None

class Written:
    def __init__(self, a: Extent, b: int = 1, c: Unknown = 0.5, d: Unknown | None = None) -> None:
        self.a, self.b, self.c, self.d = a, b, c, d

def make(a: Extent, b: int = 1, c: Unknown = 0.5, d: Unknown | None = None) -> Unknown:
    return Written(a, b, c, d)
""",
}


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


def alone(name: str) -> str:
    """A problem without neighbours, whose class has this name."""
    text = ROBOT.replace("from helper import cells", "cells = swerve.grid(theta=(0.0, 6.0, 3))")
    return text.replace("Cart", name)


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
            for values in (("beta=0.67", "max_torque=10"), ("max_torque=1e1", "beta=.67"))
            for a, b in itertools.permutations(values)
        ]
        assert {str(Specification.parse(text)) for text in texts} == {
            "pendulum?beta=0.67&max_torque=10"
        }

    @given(number=st.floats(allow_nan=False, allow_infinity=False))
    def test_numbers_keep_their_value(self, number) -> None:
        text = str(Specification.parse(f"p?a={number!r}"))
        assert float(text.removeprefix("p?a=")) == number
        assert str(Specification.parse(text)) == text

    @pytest.mark.parametrize("value", ["uniform", "True", "nan", "-inf", "64 64", "1,5", "1e999"])
    def test_other_texts_stay_as_they_are(self, value: str) -> None:
        assert str(Specification.parse(f"p?a={value}")) == f"p?a={value}"

    @pytest.mark.parametrize(
        "texts",
        [
            ["7", "007", "+7", "7.", " 7", "7_0", "70"],
            ["1.1", "1.10", "01.1"],  # versions, say
            ["9007199254740992", "9007199254740993", "0.1", "0.10000000000000001"],
            ["0", "00", "1e-400", "-0"],
            ["\u0667", "7"],  # an Arabic digit, which float() reads
        ],
    )
    def test_what_may_be_different_texts_stays_different(self, texts: list[str]) -> None:
        assert len({canonical_problem(f"robot.py:make?a={text}") for text in texts}) == len(texts)

    @pytest.mark.parametrize(
        "texts",
        [
            ["10", "10.0", "1e1", "1E+01", "1.0e1", ".1e2"],
            ["-0.25", "-.25", "-25e-2"],
            ["100000000000000000000", "1e20", "1e+20"],
        ],
    )
    def test_plain_numbers_are_written_one_way(self, texts: list[str]) -> None:
        assert len({canonical_problem(f"robot.py:make?a={text}") for text in texts}) == 1

    def test_different_values_stay_different(self) -> None:
        texts = ["p?a=1", "p?a=2", "p?b=1", "q?a=1", "p", "p?a=x", "p?a=1&b=1"]
        assert len({canonical_problem(text) for text in texts}) == len(texts)

    def test_files_are_absolute(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        (tmp_path / "sub").mkdir()
        expected = f"{tmp_path.resolve()}/robot.py:make?a=1"
        for path in ("robot.py", "./robot.py", "sub/../robot.py", f"{tmp_path}/robot.py"):
            assert canonical_problem(f"{path}:make?a=1") == expected
        assert canonical_problem("package.robot:make?a=1") == "package.robot:make?a=1"


class TestBuild:
    @staticmethod
    def call(function: Callable[..., object], query: str) -> Any:
        text = f"p?{query}"
        return build(function, Specification.parse(text), text)

    @staticmethod
    def module(monkeypatch: pytest.MonkeyPatch, name: str) -> Any:
        """A module whose names its own globals alone tell."""
        module = types.ModuleType(name)
        monkeypatch.setitem(sys.modules, name, module)
        exec(HINTED[name], vars(module))
        return module

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

    def test_parameters_without_an_annotation_have_the_type_of_their_default(self) -> None:
        half = np.float64(0.5)

        def function(a, b=True, c=3, d=0.5, e="x", f=None, g=half):
            return a, b, c, d, e, f, g

        found = self.call(function, "a=1&b=false&c=2e3&d=1&e=1&f=1&g=1")
        assert found == ("1", False, 2000, 1.0, "1", "1", 1.0)
        assert isinstance(found, tuple)
        assert [type(x) for x in found] == [str, bool, int, float, str, str, float]

    def test_so_have_those_whose_annotation_names_no_such_type(self) -> None:
        def function(a: Any = 0.5, b: Literal[1, 2] = 1, c: list | None = None, d: object = "x"):
            return a, b, c, d

        assert self.call(function, "a=1&b=2&c=3&d=4") == (1.0, 2, "3", "4")

    @pytest.mark.parametrize(
        ("query", "message"),
        [
            ("a=1.5", r"expected int, got '1.5': its default is 3, so annotate it as float if"),
            ("b=1", r"expected bool, got '1': its default is True$"),
            ("c=x", r"expected float, got 'x': its default is 0.5$"),
        ],
    )
    def test_a_value_that_is_not_of_the_type_of_the_default(self, query: str, message: str) -> None:
        def function(a=3, b=True, c=0.5) -> None: ...

        with pytest.raises(ValueError, match=rf"'p\?{query}': parameter '{query[0]}': {message}"):
            self.call(function, query)

    def test_annotations_for_type_checkers_alone_do_not_matter(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Each is resolved on its own, in the module of the function or of the class's bases."""
        _, robot = (self.module(monkeypatch, name) for name in HINTED)
        for name in ("make", "Made", "Written"):
            found = self.call(getattr(robot, name), "a=1&b=2&c=3&d=4")
            assert (found.a, found.b, found.c, found.d) == (1.0, 2, 3.0, "4"), name
            assert [type(x) for x in (found.a, found.b, found.c)] == [float, int, float], name
            with pytest.raises(ValueError, match=r"parameter 'b': expected int, got '2\.5'$"):
                self.call(getattr(robot, name), "b=2.5")
        assert self.call(functools.partial(robot.make, c=1.0), "a=1").a == 1.0

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

    def test_files_of_one_name_are_kept_apart(self, folder: Path) -> None:
        files = [folder / "robot.py", folder / "other" / "robot.py"]
        files[1].parent.mkdir()
        for file, name in zip(files, ("Cart", "Truck"), strict=True):
            file.write_text(alone(name))
        problems = [load_problem(f"{file}:problem") for file in files]
        modules = [sys.modules[type(problem.mdp).__module__] for problem in problems]
        assert [module.__file__ for module in modules] == [str(file.resolve()) for file in files]
        assert [hasattr(module, "Cart") for module in modules] == [True, False]
        assert set(source_hashes(problems[0])) >= {str(file.resolve()) for file in files}

    @pytest.mark.parametrize(
        ("name", "neighbour"),
        [
            ("helper", "helper.py"),
            ("shapes", "shapes/__init__.py"),
            ("parts.wheel", "parts/wheel.py"),
        ],
    )
    def test_a_neighbour_called_like_one_of_another_folder_is_refused(
        self, folder: Path, name: str, neighbour: str
    ) -> None:
        """Python would give the second file the first one's neighbour, without a word."""
        (folder / "parts").mkdir()
        (folder / "parts" / "__init__.py").write_text("")
        (folder / "parts" / "wheel.py").write_text("size = 1")
        (folder / "robot.py").write_text(ROBOT + "import parts.wheel\n")
        load_problem(f"{folder}/robot.py:problem")
        other = folder / "other"
        (other / neighbour).parent.mkdir(parents=True)
        (other / neighbour).write_text("")
        (other / "cart.py").write_text(f"import {name}\n")
        first = folder.joinpath(*name.split(".")).with_suffix(".py")
        message = (
            f"{other}/cart.py: `import {name}` would not give its neighbour {other / neighbour} "
            f"but {first}, which is imported already: rename one of the two, or use the two in "
            "separate processes"
        )
        with pytest.raises(ValueError, match=re.escape(message)):
            load_problem(f"{other}/cart.py:problem")

    def test_other_names_and_the_same_folder_again_are_no_clash(self, folder: Path) -> None:
        load_problem(f"{folder}/robot.py:problem")
        other = folder / "other"
        other.mkdir()
        for name in ("numpy", "swerve", "__main__"):
            (other / f"{name}.py").write_text("")
        (other / "helper_of_another_name.py").write_text("")
        (other / "shapes.py").write_text(alone("Truck"))  # itself called like a neighbour
        assert load_problem(f"{other}/shapes.py:problem").beta == 0.5
        assert load_problem(f"{folder}/robot.py:problem").beta == 0.5

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("walker9", "'walker9' is no problem: expected one of car, .*a path/to/file.py:"),
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
        ("line", "message"),
        [
            ("1 / 0", r"robot\.py, line {}: ZeroDivisionError: division by zero"),
            ("import wheels", r"robot\.py, line {}: ModuleNotFoundError: No module named 'wheels'"),
            ("x = = 1", r"robot\.py, line {}: SyntaxError: invalid syntax"),
            (
                "class Stub(swerve.MDP):\n    pass\nStub()",
                r"robot\.py, line {}: TypeError: .* Stub .*dynamics",
            ),
            ("swerve.Box(x=(1, 0))", r"robot\.py, line {}: Box: expected low < high"),
            ("def late():\n    return {{}}['a']\n", r"robot\.py, line {}: KeyError: 'a'"),
        ],
    )
    def test_a_mistake_in_the_file_is_found_for_its_author(
        self, folder: Path, line: str, message: str
    ) -> None:
        """And may be mended: the file is read anew."""
        path, name = folder / "robot.py", "late" if "late" in line else "problem"
        right = path.read_text()
        path.write_text(f"{right}\nimport swerve\n{line.format()}\n")
        number = right.count("\n") + 3 + line.strip().count("\n")
        with pytest.raises(ValueError, match=message.format(number)):
            load_problem(f"{path}:{name}")
        path.write_text(right)
        assert load_problem(f"{path}:problem").beta == 0.5

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
        assert within <= {"mdp.py", "systems/pendulum.py"}
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

    def test_are_of_whatever_is_imported(self, folder: Path) -> None:
        """A module that the problem does not use is among them, a script is not."""
        problem = load_problem(f"{folder}/robot.py:problem")
        (folder / "unrelated.py").write_text("")
        assert str(folder / "unrelated.py") not in source_hashes(problem)
        importlib.invalidate_caches()
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


def test_a_file_that_is_moved_holds_the_same_problem(tmp_path: Path) -> None:
    text = (
        "import swerve\n"
        "class Own(swerve.Pendulum):\n    pass\n"
        "problem = swerve.Problem(Own(), swerve.grid(theta=(0, 1, 2)))\n"
    )
    prints = []
    for place in ("here/robot.py", "there/robot.py", "there/other.py"):
        path = tmp_path / place
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        prints.append(load_problem(f"{path}:problem").record.fingerprint)
    assert prints[0] == prints[1] != prints[2]
