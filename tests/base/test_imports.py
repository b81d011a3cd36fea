"""Libraries never see the folders of the user; a user's file sees its own."""

from __future__ import annotations

import html
import importlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import swerve
from swerve.base import imports
from swerve.problem.loading import canonical_problem, load_problem

SHADOWS = (
    *("jax", "html", "numpy", "scipy", "equinox", "optax", "polars", "rich", "matplotlib"),
    *("cyclopts", "msgspec", "random", "zoneinfo", "tensorflow", "colorama", "typing_extensions"),
)
BEFORE_SWERVE = ("swerve", "types")  # `python -m` runs these before anything of Swerve, of itself
PROBLEM, SETTINGS = "gridworld", ("--json",)
SCRIPT = f"""
import sys
from swerve.cli.app import main
sys.argv = ["swerve", "infer", {PROBLEM!r}, *{SETTINGS!r}]
main()
"""
CART = """
import swerve

def problem(beta: float = 0.5):
    cells = swerve.grid(theta=(0.0, 6.0, 3))
    return swerve.Problem(swerve.Pendulum(num_steps=3), cells, beta=beta)
"""


def shadowed(folder: Path, names: tuple[str, ...]) -> Path:
    """Make a folder of modules that leave a mark and fail when they are run."""
    folder.mkdir()
    mark = folder / "mark"
    for name in names:
        text = f"open({str(mark)!r}, 'a').write({name!r})\nraise SystemExit('{name} was run')\n"
        (folder / f"{name}.py").write_text(text)
    return folder


def answer(folder: Path, *command: object) -> object:
    """Return what a command prints in a folder, as data without the times."""
    keep = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    environment = keep | {"JAX_PLATFORMS": "cpu"}
    texts = [str(part) for part in command]
    run = subprocess.run(
        texts, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    assert not (folder / "mark").exists(), (folder / "mark").read_text()
    return json.loads(run.stdout)


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> object:
    """The answer in an empty folder."""
    folder = tmp_path_factory.mktemp("empty")
    return answer(folder, Path(sys.executable).parent / "swerve", "infer", PROBLEM, *SETTINGS)


class TestLibraries:
    def test_the_command_runs_nothing_of_the_current_folder(
        self, tmp_path: Path, expected: object
    ) -> None:
        folder = shadowed(tmp_path / "here", (*SHADOWS, *BEFORE_SWERVE))
        command = Path(sys.executable).parent / "swerve"
        assert answer(folder, command, "infer", PROBLEM, *SETTINGS) == expected

    def test_nor_does_the_package(self, tmp_path: Path, expected: object) -> None:
        folder = shadowed(tmp_path / "here", SHADOWS)
        command = (sys.executable, "-m", "swerve", "infer", PROBLEM, *SETTINGS)
        assert answer(folder, *command) == expected

    def test_a_script_may_have_the_name_of_a_module(self, tmp_path: Path, expected: object) -> None:
        others = tuple(name for name in SHADOWS if name not in ("tensorflow", "colorama"))
        folder = shadowed(tmp_path / "here", others)
        (folder / "html.py").write_text(SCRIPT)
        assert answer(folder, sys.executable, "html.py") == expected


AGAIN = """
import json, sys
import swerve.base.imports
{change}
import swerve.base.imports, swerve.base.space
names = [getattr(finder, "__name__", "") for finder in sys.meta_path]
print(json.dumps([names.count("PathFinder"), sys.meta_path[-1] is swerve.base.imports.PathFinder]))
"""


@pytest.mark.parametrize(
    "change",
    [
        "import importlib; importlib.reload(swerve.base.imports)",
        "for name in [*sys.modules]: name.startswith('swerve') and sys.modules.pop(name)",
        "del sys.meta_path[-1]; swerve.base.imports._take_place()",
    ],
    ids=["reload", "anew", "without a finder"],
)
def test_the_module_may_be_run_again(change: str, tmp_path: Path) -> None:
    """As by tools that reload what has changed; where there is no finder there is one again."""
    assert answer(tmp_path, sys.executable, "-c", AGAIN.format(change=change)) == [1, True]


READER = """
import importlib, importlib.util, pickle

def optional():
    try:
        import absent_part
        return True
    except ModuleNotFoundError:
        return importlib.util.find_spec("absent_part") is not None

def fixed():
    return importlib.import_module("absent_part")

def given(name):
    return importlib.import_module(name)

read = pickle.loads
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder for scripts, in which a library does not find what it may do without."""
    shadowed(tmp_path / "here", ("absent_part",))
    library = tmp_path / "site-packages"
    library.mkdir()
    (library / "reader_of_parts.py").write_text(READER)
    return tmp_path / "here"


def said_by(place: Path, script: str) -> object:
    """Return what a script prints beside the files of a folder."""
    library = str(place.parent / "site-packages")
    start = f"import json, sys\nsys.path.append({library!r})\n"
    (place / "start.py").write_text(f"{start}{script}")
    return answer(place, sys.executable, "start.py")


class TestOptionalModules:
    @pytest.mark.parametrize("first", ["", "sys.path.insert(0, 'lib')", "sys.path.append('.')"])
    def test_of_a_library_are_not_those_of_the_user(self, place: Path, first: str) -> None:
        script = f"""{first}
import swerve, reader_of_parts
try:
    fixed = reader_of_parts.fixed()
except ModuleNotFoundError as error:
    fixed = error.name
print(json.dumps([reader_of_parts.optional(), fixed]))
"""
        assert said_by(place, script) == [False, "absent_part"]

    def test_of_folders_named_by_the_user_are_found(self, place: Path) -> None:
        (place / "lib").mkdir()
        (place / "lib" / "absent_part.py").write_text("")
        script = """sys.path.insert(0, "lib")
import swerve, reader_of_parts
print(json.dumps(reader_of_parts.fixed().__file__))
"""
        assert said_by(place, script) == str(place / "lib" / "absent_part.py")

    def test_of_the_current_folder_are_found_where_a_pth_file_names_it(self, place: Path) -> None:
        (place / "absent_part.py").write_text("")
        (place.parent / "site-packages" / "here.pth").write_text(f"{place}\n")
        script = "import swerve, reader_of_parts\nprint(json.dumps(reader_of_parts.optional()))\n"
        assert said_by(place, script) is True

    def test_whose_names_a_script_gives_are_found(self, place: Path) -> None:
        (place / "model_of_cart.py").write_text("class Wheel: pass\n")
        script = """import swerve, reader_of_parts
wheel = reader_of_parts.read(b"cmodel_of_cart\\nWheel\\n.")
print(json.dumps([wheel.__name__, reader_of_parts.given("model_of_cart").__name__]))
"""
        assert said_by(place, script) == ["Wheel", "model_of_cart"]

    def test_a_cell_of_a_notebook_sees_its_folder(self, place: Path) -> None:
        (place / "absent_part.py").write_text("BETA = 0.25\n")
        script = """import swerve
cell = "import absent_part; print(json.dumps(absent_part.BETA))"
exec(compile(cell, "/elsewhere/cell_1.py", "exec"))
"""
        assert said_by(place, script) == 0.25


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The current folder, whose modules are forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setattr(imports, "_folders", {})
    path = list(sys.path)
    yield tmp_path
    assert sys.path == path
    for name, module in list(sys.modules.items()):
        if str(tmp_path) in str(getattr(module, "__file__", "")):
            del sys.modules[name]


class TestNeighbours:
    def test_files_and_packages_are_found_at_any_time(self, folder: Path) -> None:
        (folder / "parts_of_cart").mkdir()
        (folder / "parts_of_cart" / "wheel.py").write_text("import masses_of_cart\nSIZE = 0.5\n")
        (folder / "masses_of_cart.py").write_text("MASS = 1.0\n")
        (folder / "late_in_cart.py").write_text("BETA = 0.25\n")
        text = CART.replace("import swerve", "import swerve\nfrom parts_of_cart.wheel import SIZE")
        (folder / "cart.py").write_text(
            f"{text}\ndef late():\n    import late_in_cart\n"
            "    return problem(late_in_cart.BETA + SIZE)\n"
        )
        assert load_problem("cart.py:problem").beta == 0.5
        assert load_problem("cart.py:late").beta == 0.75

    def test_nobody_else_finds_them(self, folder: Path) -> None:
        (folder / "only_of_cart.py").write_text("")
        (folder / "cart.py").write_text(CART)
        load_problem("cart.py:problem")
        with pytest.raises(ModuleNotFoundError, match="only_of_cart"):
            importlib.import_module("only_of_cart")

    @pytest.mark.parametrize("reader", ["pickle.loads", "pickle._loads"])
    def test_are_found_by_the_name_of_a_pickled_class(self, folder: Path, reader: str) -> None:
        (folder / "wheel_of_cart.py").write_text("class Wheel: pass\n")
        read = f'import pickle\n{reader}(b"cwheel_of_cart\\nWheel\\n.")\n'
        (folder / "cart.py").write_text(f"{read}{CART}")
        assert load_problem("cart.py:problem").beta == 0.5

    def test_plain_folders_hide_no_package_of_their_name(
        self, folder: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        source = folder / "clone_of_cart" / "src"
        (source / "clone_of_cart").mkdir(parents=True)
        (source / "clone_of_cart" / "__init__.py").write_text("BETA = 0.25\n")
        (source / "clone_of_cart" / "robots.py").write_text(CART)
        text = f"from clone_of_cart import BETA\n{CART.replace('0.5', 'BETA')}"
        (folder / "cart.py").write_text(text)
        with monkeypatch.context() as context:
            context.setattr(sys, "path", [*sys.path, str(source)])
            assert load_problem("cart.py:problem").beta == 0.25
            assert load_problem("clone_of_cart.robots:problem").beta == 0.5

    @pytest.mark.parametrize("name", ["html", "numpy", "polars", "profile", "time"])
    @pytest.mark.parametrize("text", ["cart.py:problem", "cart:problem", "outer_cart.py:problem"])
    def test_with_the_name_of_an_installed_module_are_refused(
        self, folder: Path, name: str, text: str
    ) -> None:
        for file in ("cart.py", "outer_cart.py"):
            (folder / file).write_text(CART)
        assert load_problem(text).beta == 0.5
        for module in ("cart", "outer_cart"):
            sys.modules.pop(module, None)
        (folder / f"{name}.py").write_text("raise SystemExit\n")
        (folder / "cart.py").write_text(f"def late():\n    import {name}.x\n{CART}")
        (folder / "outer_cart.py").write_text("from cart import problem\n")
        message = (
            rf"cart.py: `import {name}` .* neighbour {folder}/{name}\.py but .*: rename the neig"
        )
        with pytest.raises(ValueError, match=message):
            load_problem(text)

    def test_that_are_not_imported_may_have_any_name(self, folder: Path) -> None:
        for name in ("html", "numpy", "polars", "swerve"):
            (folder / f"{name}.py").write_text("raise SystemExit\n")
        (folder / "cart.py").write_text(CART)
        assert load_problem("cart.py:problem").beta == 0.5
        assert sys.modules["html"] is html
        assert sys.modules["numpy"] is np

    def test_of_packages_are_refused_too(self, folder: Path) -> None:
        (folder / "axle_of_cart").mkdir()
        (folder / "axle_of_cart" / "wheel.py").write_text("import profile\n")
        (folder / "profile.py").write_text("")
        (folder / "cart.py").write_text(f"import axle_of_cart.wheel\n{CART}")
        sys.modules.pop("profile", None)
        with pytest.raises(
            ValueError, match=r"wheel\.py: `import profile` .* rename the neighbour"
        ):
            load_problem("cart.py:problem")


class TestModulesOfTheCurrentFolder:
    def test_are_found_for_the_problem_alone(self, folder: Path) -> None:
        (folder / "garage_of_carts").mkdir()
        (folder / "garage_of_carts" / "__init__.py").write_text("import tools_of_carts\n")
        (folder / "garage_of_carts" / "cart.py").write_text(f"import tools_of_carts\n{CART}")
        (folder / "tools_of_carts.py").write_text("")
        text = "garage_of_carts.cart:problem"
        before = canonical_problem(text)
        assert before == f"{text} in {folder}/garage_of_carts"
        problem = load_problem(f"{text}?beta=0.25")
        assert problem.beta == 0.25
        assert canonical_problem(text) == before
        assert "tools_of_carts" in sys.modules

    @pytest.mark.parametrize("name", ["html", "swerve", "numpy"])
    def test_may_have_the_name_of_an_installed_one(self, folder: Path, name: str) -> None:
        before = sys.modules[name]
        (folder / f"{name}.py").write_text(CART)
        assert canonical_problem(f"{name}:problem") == f"{name}:problem in {folder}"
        assert load_problem(f"{name}:problem").beta == 0.5
        assert load_problem(f"{name}.py:problem").beta == 0.5
        assert sys.modules[name] is before
        assert type(load_problem("pendulum").mdp) is swerve.Pendulum

    def test_a_folder_without_init_that_was_imported_before_is_the_users(
        self, folder: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (folder / "barn_of_carts").mkdir()
        (folder / "barn_of_carts" / "cart.py").write_text(CART)
        with monkeypatch.context() as once:
            once.syspath_prepend(folder)
            importlib.import_module("barn_of_carts")
        assert load_problem("barn_of_carts.cart:problem").beta == 0.5

    def test_a_folder_with_the_name_of_an_installed_one_is_refused(self, folder: Path) -> None:
        (folder / "numpy").mkdir()
        (folder / "numpy" / "__init__.py").write_text("")
        (folder / "numpy" / "cart.py").write_text(CART)
        message = "'numpy.cart:problem': the folder 'numpy' has the name of a module that is inst"
        with pytest.raises(ValueError, match=message):
            load_problem("numpy.cart:problem")
        assert load_problem("numpy/cart.py:problem").beta == 0.5

    def test_an_error_in_one_is_told_and_may_be_mended(self, folder: Path) -> None:
        (folder / "broken_cart.py").write_text("1 / 0\n")
        with pytest.raises(ValueError, match=r"broken_cart\.py, line 1: ZeroDivisionError"):
            load_problem("broken_cart:problem")
        (folder / "broken_cart.py").write_text(CART)
        assert load_problem("broken_cart:problem").beta == 0.5
