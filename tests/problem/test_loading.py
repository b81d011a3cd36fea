"""Problems by name, in files and in modules."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from support.problem_files import ROBOT, SHAPES, alone

import swerve
from swerve.problem.loading import SHIPPED, load_problem, source_hashes
from swerve.problem.problem import Problem


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

    @pytest.mark.parametrize("name", [b"rob\xff.py", b"rob\xff/robot.py"])
    def test_a_path_that_is_no_text_is_refused(self, folder: Path, name: bytes) -> None:
        """JAX keeps the file of each line that it compiles, and would end in std::bad_cast."""
        path = folder / os.fsdecode(name)
        path.parent.mkdir(exist_ok=True)
        path.write_text(ROBOT)
        with pytest.raises(
            ValueError, match=r"expected a path in UTF-8, .* rename the file or fol"
        ):
            load_problem(f"{path}:problem")

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

    def test_a_path_without_its_ending_is_met_with_the_one_that_is_meant(
        self, folder: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (folder / "below").mkdir()
        monkeypatch.chdir(folder / "below")
        message = r"'\.\./robot:problem': .*: do you mean \.\./robot\.py:problem\?$"
        with pytest.raises(ValueError, match=message):
            load_problem("../robot:problem")
        assert load_problem("../robot.py:problem").beta == 0.5

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("walker9", "'walker9' names no problem: expected one of car, .*a path/to/file.py:"),
            (
                "../robot:problem",
                r"'\.\./robot' is neither a file that ends in \.py nor",
            ),
            ("..robot:problem", "is neither a file that ends in .py nor the name of a module"),
            ("sub/robot:problem", "neither a file .*, as in path/to/file.py:name or package"),
            ("/:problem", "'/' is neither a file that ends in .py nor the name of a module"),
            (":problem", "'' is neither a file that ends in .py nor the name of a module"),
            ("a..b:problem", "'a..b' is neither a file"),
            ("robot.py:problem:", "'robot.py:problem' is neither a file"),
            ("robot.py :problem", "'robot.py ' is neither a file"),
            ("robot.py:", "robot.py: no such file"),
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
            (
                "class Odd(type(problem.mdp)):\n    actions = ['go']\nswerve.Problem(Odd(), [])",
                r"robot\.py, line {}: Odd\.actions: expected numbers, got \['go'\]",
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
