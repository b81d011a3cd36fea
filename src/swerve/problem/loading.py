"""Load the problem that a text names, such as "pendulum?max_torque=10" or "robot.py:problem".

The text is a specification (see `base.specification`) whose target is a shipped name, a file or a
module. The source files that a problem may have come from are hashed. So a change of these files is
noticed, for a stored result, without running them.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import re
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any
from weakref import WeakKeyDictionary

from swerve.base import imports
from swerve.base.files import open_regular
from swerve.base.forked import check_process
from swerve.base.specification import Specification, build

SHIPPED = {
    "car": "swerve.systems.car:car",
    "double-pendulum": "swerve.systems.double_pendulum:double_pendulum",
    "pendulum": "swerve.systems.pendulum:pendulum",
    "gridworld": "swerve.systems.gridworld:gridworld",
}
MOST_BYTES = 2**26  # of a source file
MODULE = re.compile(r"[^\s./\\:]+(\.[^\s./\\:]+)*")  # names between dots, which are no paths
MISSING = "missing"  # in place of the hash of a file that cannot be read
_SEEN: WeakKeyDictionary[ModuleType, str] = WeakKeyDictionary()  # hash of each module's file


def canonical_problem(text: str) -> str:
    """Return the canonical text of a specification, the same for all texts of one problem.

    Paths of files become absolute, modules get their folder, parameters are sorted, and plain
    numbers are written in one way: 10, 10.0 and 1e1 are the same. No code is loaded, so nothing
    tells which parameters are numbers: a value that is more likely a text, or has more digits than
    a float (007, 1.10, 1_000), stays as it is. Mistaking one problem for two costs a message;
    mistaking two problems for one would give a wrong answer.
    """
    specification = Specification.parse(text)
    path, colon, name = specification.target.rpartition(":")
    if colon and path.endswith(".py"):
        target = f"{Path(path).resolve()}:{name}"
        return str(Specification(target, specification.parameters))
    return f"{specification}{_place(path)}" if colon else str(specification)


def _place(module: str) -> str:
    """Return ' in FOLDER' for a module that is not installed, '' for an installed module."""
    top = module.partition(".")[0]
    found = _found_here(module)
    if found is None:
        try:
            found = importlib.util.find_spec(top)
        except ValueError:  # a module that was not made from a file
            return ""
    places = [found.origin, *(found.submodule_search_locations or ())] if found else []
    files = [Path(place) for place in places if place]
    return f" in {files[0].parent}" if files and _is_user_source(files[0]) else ""


def _found_here(module: str) -> ModuleSpec | None:
    """Return the specification of a module's top-level name in the current folder, if any.

    A module that was imported from another folder of the user is found there, not here.
    """
    top, dot, _ = module.partition(".")
    if dot and top == "swerve":
        return None
    loaded = sys.modules.get(top)
    file = getattr(loaded, "__file__", None)
    places = [file] if file else list(getattr(loaded, "__path__", ()))  # without __init__.py
    if places and top != "swerve" and not any(map(imports.is_installed, places)):
        return None
    found = imports.find_in(str(Path.cwd()), top)
    is_package = found is not None and found.submodule_search_locations is not None
    return None if dot and not is_package else found


def load_problem(text: str) -> Any:
    """Return the Problem that a specification names.

    Args:
      text: a shipped name ("pendulum"), "path/to/file.py:name" or "package.module:name", with
        parameters after "?" where the name is a function that returns a Problem.

    Raises:
      ValueError: if the text names no object, or an object that is not a Problem.
      RuntimeError: in a process that was forked after JAX had begun to run.
    """
    from swerve.problem.problem import Problem

    check_process()
    specification = Specification.parse(text)
    target = SHIPPED.get(specification.target, specification.target)
    path, colon, name = target.rpartition(":")
    if not colon:
        raise ValueError(
            f"{text!r} names no problem: expected one of {', '.join(SHIPPED)}, a "
            "path/to/file.py:name or a package.module:name"
        )
    if not path.endswith(".py") and not MODULE.fullmatch(path):
        meant = f": do you mean {path}.py:{name}?" if Path(f"{path}.py").is_file() else ""
        raise ValueError(
            f"{text!r}: {path!r} is neither a file that ends in .py nor the name of a module, as "
            f"in path/to/file.py:name or package.module:name{meant}"
        )
    module = _load_file(Path(path)) if path.endswith(".py") else _load_module(path, text)
    if not hasattr(module, name):
        raise ValueError(f"{text!r}: {path} defines no {name!r}")
    found = getattr(module, name)
    if callable(found) and not isinstance(found, Problem):
        with _user_code():
            found = build(found, specification, text)
    elif specification.parameters:
        raise ValueError(
            f"{text!r}: {name!r} is a Problem, not a function that returns one, "
            "so it takes no parameters"
        )
    if not isinstance(found, Problem):
        raise ValueError(f"{text!r}: expected a swerve.Problem, got {type(found).__name__}")
    source_hashes(found)  # now, while the files are still those that were imported
    return found


def source_hashes(problem: Any) -> dict[str, str]:
    """Return the hash of every source file that a problem may have come from.

    The hashed files are the `.py` files, without installed packages and the standard library, of

    - all modules that are imported now, whether or not the problem uses them, except Swerve's own
      and the script that Python was started with;
    - the modules that define the classes of the MDP, even that script or Swerve's own modules.

    Data files, compiled modules and modules imported later are left out. A module keeps its first
    hash, since the code that runs is the code that was imported then.
    """
    modules = {name: sys.modules[name] for name in _user_modules()}
    for base in type(problem.mdp).__mro__:
        modules[base.__module__] = sys.modules[base.__module__]
    hashes = {}
    for module in modules.values():
        path = Path(str(getattr(module, "__file__", None)))
        if _is_user_source(path):
            hashes[str(path)] = _SEEN.setdefault(module, file_hash(path))
    return dict(sorted(hashes.items()))


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a source file; "missing" if it cannot be read, or is no source file.

    A work folder of others may name any file, such as a pipe or a device.
    """
    try:
        with open_regular(path) as file:
            content = file.read(MOST_BYTES + 1)
    except (OSError, ValueError):  # ValueError: a name that no file can have
        return MISSING
    if content is None or len(content) > MOST_BYTES:  # None: a log of the system, without news
        return MISSING
    return hashlib.sha256(content).hexdigest()


def _user_modules() -> dict[str, Path]:
    """Return the files of imported modules, except Swerve's, installed modules and `__main__`."""
    files = {
        name: Path(file)
        for name, module in list(sys.modules.items())
        for file in [getattr(module, "__file__", None)]
        if file and name != "__main__" and name.partition(".")[0] != "swerve"
    }
    return {name: path for name, path in files.items() if _is_user_source(path)}


def _is_user_source(path: Path) -> bool:
    return path.suffix == ".py" and not imports.is_installed(str(path))


def _load_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise ValueError(f"{path}: no such file")
    path = path.resolve()
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise ValueError(
            f"{path}: expected a path in UTF-8, which JAX needs for code: rename the file or folder"
        ) from None
    _check_neighbours(path)
    imports.check_names(str(path), str(path.parent))
    # a name that neither an installed module nor a file of this name in another folder can have
    name = f"swerve_problem_{path.stem}_{hashlib.sha256(bytes(path)).hexdigest()[:8]}"
    imports.looking_in(str(path.parent), name)
    specification = importlib.util.spec_from_file_location(name, path)
    assert specification is not None
    with _user_code():
        return _run(importlib.util.module_from_spec(specification), specification)


@contextmanager
def _user_code() -> Iterator[None]:
    """Turn any error in a user's code into a ValueError that names the file and the line.

    An error without a line of a user's file in its traceback stays as it is.
    """
    try:
        yield
    except Exception as error:
        lines = [
            f"{frame.f_code.co_filename}, line {number}"
            for frame, number in traceback.walk_tb(error.__traceback__)
            if frame.f_globals.get("__name__", "").partition(".")[0] != "swerve"
            and _is_user_source(Path(frame.f_code.co_filename))
        ]
        if isinstance(error, SyntaxError) and error.filename:
            lines.append(f"{error.filename}, line {error.lineno}")
        if not lines:
            raise
        is_plain = type(error) is ValueError or type(error).__module__.startswith("swerve.")
        kind = "" if is_plain else f"{type(error).__name__}: "
        text = error.msg if isinstance(error, SyntaxError) else error
        raise ValueError(f"{lines[-1]}: {kind}{text}") from error


def _check_neighbours(path: Path) -> None:
    """Raise ValueError where a file would not import its neighbour but another folder's module.

    Python keeps one module of each name. To replace that module by the neighbour would only move
    the mistake: functions of the file that was loaded first may import the name when they are
    called.
    """
    for name, loaded in _user_modules().items():
        stem = path.parent.joinpath(*name.split("."))
        for neighbour in (stem.with_suffix(".py"), stem / "__init__.py"):
            if neighbour != path and neighbour.is_file() and not _same(neighbour, loaded):
                raise ValueError(
                    f"{path}: `import {name}` would not give its neighbour {neighbour} but "
                    f"{loaded}, which is imported already: rename one of the two, or use the two "
                    "in separate processes"
                )


def _same(a: Path, b: Path) -> bool:
    return a.resolve() == b.resolve()


def _load_module(name: str, text: str) -> ModuleType:
    """Import a module of the current folder or, where there is none, one that Python finds."""
    here, top = _found_here(name), name.partition(".")[0]
    if here is not None and (top in sys.modules or imports.find_installed(top) is not None):
        if here.submodule_search_locations is None and here.origin is not None:
            return _load_file(Path(here.origin))  # under a name that takes no other's place
        raise ValueError(
            f"{text!r}: the folder {top!r} has the name of a module that is installed: rename the "
            "folder, or name the file, as in path/to/file.py:name"
        )
    try:
        with _user_code():
            if here is not None:
                if here.origin is not None and here.origin.endswith(".py"):
                    imports.check_names(here.origin, str(Path.cwd()))
                imports.looking_in(str(Path.cwd()), top)
                _run(importlib.util.module_from_spec(here), here)
            return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise ValueError(f"{text!r}: {error}") from error


def _run(module: ModuleType, specification: ModuleSpec) -> ModuleType:
    """Run a new module and keep it among the imported ones, unless it fails."""
    assert specification.loader is not None
    sys.modules[module.__name__] = module
    try:
        specification.loader.exec_module(module)
    except BaseException:
        del sys.modules[module.__name__]
        raise
    return module
