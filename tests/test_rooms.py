"""Packages import only packages below them, and what needs no JAX imports none.

    python tests/test_rooms.py

prints the packages in order, with how often each imports which.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest
from support.rooms import ROOMS, WITH_JAX

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "src" / "swerve"
STORED = ROOT / "tests" / "data" / "before_packages"

WITH_MATPLOTLIB = ("base.figure_style", "presentation", "solvers.trained.history_plot", "reproduce")
JAX = {"jax", "jaxlib", "equinox", "optax"}
BY_NAME = ("swerve", "problem.loading", "solvers.learn", "cli.reproduce")  # import by text
SIZES = {"module": 350, "function": 50}  # most lines


TYPES_ALONE = ("TYPE_CHECKING", "typing.TYPE_CHECKING")


class Import(NamedTuple):
    """One import statement.

    Attributes:
      module: what is imported, for example 'swerve.base.space' or 'jax'.
      line: where.
      at_once: whether it runs when the importing module is imported.
    """

    module: str
    line: int
    at_once: bool


@cache
def modules() -> dict[str, Path]:
    """Return all modules of the library by their names without 'swerve.'."""
    found = {}
    for path in sorted(SOURCES.rglob("*.py")):
        parts = path.relative_to(SOURCES).with_suffix("").parts
        name = ".".join(part for part in parts if part != "__init__")
        found[name or "swerve"] = path
    del found["__main__"]
    return found


@cache
def imports_of(module: str) -> tuple[Import, ...]:
    """Return every import of a module, those for type checkers and in functions included."""
    found = _imports(ast.parse(modules()[module].read_text()), at_once=True)
    return tuple(dict.fromkeys(found))  # several names from one module are one import


def _imports(node: ast.AST, at_once: bool) -> Iterator[Import]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import):
            for alias in child.names:
                yield Import(alias.name, child.lineno, at_once)
        elif isinstance(child, ast.ImportFrom):
            assert child.module is not None
            assert child.level == 0, "no relative imports"
            for alias in child.names:
                full = f"{child.module}.{alias.name}"
                is_module = full.removeprefix("swerve.") in modules()
                yield Import(full if is_module else child.module, child.lineno, at_once)
        elif isinstance(child, ast.If) and ast.unparse(child.test) in TYPES_ALONE:
            for part in child.body:
                yield from _imports(ast.Module([part], []), at_once=False)
            yield from _imports(ast.Module(child.orelse, []), at_once)
        else:
            is_function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            yield from _imports(child, at_once and not is_function)


def own(imported: str) -> str | None:
    """Return the module of the library that an import names, None for other libraries."""
    if imported == "swerve":
        return "swerve"
    return imported.removeprefix("swerve.") if imported.startswith("swerve.") else None


def room(module: str) -> str:
    """Return the package that a module lies in; a module beside the packages is its own room."""
    return module.partition(".")[0]


def counts() -> dict[str, Counter[str]]:
    """Return how often each package imports which other."""
    found = {name: Counter() for name in ROOMS}
    for module in modules():
        for item in imports_of(module):
            target = own(item.module)
            if target is not None and room(target) != room(module):
                found[room(module)][room(target)] += 1
    return found


def is_in(module: str, places: tuple[str, ...]) -> bool:
    """Return whether a module is one of some modules and packages, or lies in one."""
    return any(module == place or module.startswith(f"{place}.") for place in places)


def test_every_package_has_a_place_and_says_what_belongs_there() -> None:
    assert {room(module) for module in modules()} == set(ROOMS)
    for module, path in modules().items():
        if path.name == "__init__.py":
            text = ast.get_docstring(ast.parse(path.read_text()))
            assert text, module
            assert text.partition("\n")[0].endswith("."), module


@pytest.mark.parametrize("module", [name for name in modules() if name != "swerve"])
def test_imports_run_one_way(module: str) -> None:
    for item in imports_of(module):
        target = own(item.module)
        if target is None:
            continue
        where = f"{module}, line {item.line}: imports {item.module}"
        assert ROOMS.index(room(target)) <= ROOMS.index(room(module)), where


@pytest.mark.parametrize("module", [name for name in modules() if name not in BY_NAME])
def test_modules_are_imported_by_statements(module: str) -> None:
    """Imports by text escape the other tests; those there are name what the tables name."""
    for node in ast.walk(ast.parse(modules()[module].read_text())):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            assert called.rpartition(".")[2] not in ("import_module", "__import__"), module


def test_modules_and_functions_are_short() -> None:
    for path in sorted((ROOT / "src").rglob("*.py")) + sorted((ROOT / "tests").rglob("*.py")):
        text = path.read_text()
        assert text.count("\n") <= SIZES["module"], path
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.end_lineno:
                length = node.end_lineno - node.lineno + 1
                assert length <= SIZES["function"], f"{path}: {node.name}"


def test_no_module_is_in_a_circle() -> None:
    done: set[str] = set()
    path: list[str] = []

    def visit(module: str) -> None:
        assert module not in path, " -> ".join([*path[path.index(module) :], module])
        if module in done:
            return
        path.append(module)
        for item in imports_of(module):
            target = own(item.module)
            if target not in (None, "swerve", module):
                assert target is not None
                visit(target)
        done.add(path.pop())

    for module in modules():
        if module != "swerve":
            visit(module)


def loaded_by(module: str) -> Iterator[tuple[str, str]]:
    """Yield what importing a module imports at once, directly or not, and which module does."""
    seen, todo = {module}, [module]
    while todo:
        current = todo.pop()
        for item in imports_of(current):
            if not item.at_once:
                continue
            yield item.module, current
            target = own(item.module)
            if target is not None and target != "swerve" and target not in seen:
                seen.add(target)
                todo.append(target)


@pytest.mark.parametrize("module", [name for name in modules() if not is_in(name, WITH_JAX)])
def test_what_needs_no_jax_imports_none(module: str) -> None:
    for imported, by in loaded_by(module):
        assert imported.partition(".")[0] not in JAX, f"{module} imports JAX by {by}"


@pytest.mark.parametrize("module", [name for name in modules() if not is_in(name, WITH_MATPLOTLIB)])
def test_matplotlib_is_imported_where_pictures_are_drawn(module: str) -> None:
    for item in imports_of(module):
        assert item.module.partition(".")[0] != "matplotlib", f"{module}, line {item.line}"


def test_stored_evidence_is_inferred_from_monitored_and_reported_without_jax(
    tmp_path: Path,
) -> None:
    code = """
import sys
for name in ("jax", "jaxlib", "equinox", "optax"):
    sys.modules[name] = None
import numpy as np
import swerve
evidence = swerve.Evidence.load(sys.argv[1] + "/grid.evidence")
foresight = swerve.Foresight.load(sys.argv[1] + "/grid.foresight", evidence.problem)
task = swerve.Task(evidence.tasks.start[0], evidence.tasks.goal[0])
states = np.linspace(task.start, task.goal, 7)
result = swerve.infer(evidence, [swerve.Demonstration("line", states, task)])
result.report(sys.argv[2])
monitor = swerve.Monitor(evidence, task, foresight)
entered = {index for state in states for index in monitor.observe(state).entered}
assert sorted(entered) == np.flatnonzero(result.entered[0]).tolist()
print(result.headline)
import importlib
for name in sys.argv[3:]:
    importlib.import_module(f"swerve.{name}")
"""
    page = tmp_path / "report.html"
    others = [name for name in modules() if name != "swerve" and not is_in(name, WITH_JAX)]
    command = [sys.executable, "-c", code, str(STORED), str(page), *others]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert "<svg" in page.read_text() or "<img" in page.read_text()


def main() -> None:
    """Print how often each package imports which."""
    found = counts()
    for place, name in enumerate(ROOMS):
        below = ", ".join(f"{other} {found[name][other]}" for other in ROOMS if found[name][other])
        above = [other for other in found[name] if ROOMS.index(other) > place]
        alarm = f"   UPWARD: {', '.join(above)}" if above else ""
        print(f"{place + 1:>2} {name:<15} {below or '-'}{alarm}")


if __name__ == "__main__":
    main()
