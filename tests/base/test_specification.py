"""Texts that name a thing and its parameters."""

from __future__ import annotations

import functools
import itertools
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from swerve.base.specification import Specification, build
from swerve.problem.loading import canonical_problem

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
