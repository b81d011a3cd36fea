"""Texts that name a thing and its parameters: "pendulum?max_torque=10", "robot.py:problem".

A specification is a target and parameters, `target?name=value&name=value`. Parameters are
converted to the types that the target's signature gives them.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import math
import sys
import sysconfig
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, get_args, get_type_hints

SHIPPED = {"pendulum": "swerve.systems.pendulum:pendulum"}


@dataclass(frozen=True)
class Specification:
    """A target and the texts of its parameters."""

    target: str
    parameters: tuple[tuple[str, str], ...]

    @classmethod
    def parse(cls, text: str) -> Specification:
        """Split "target?a=1&b=2".

        Raises:
          ValueError: if a parameter is not of the form name=value, or is given twice.
        """
        target, _, query = text.partition("?")
        parameters: dict[str, str] = {}
        for item in query.split("&") if query else []:
            name, equals, value = item.partition("=")
            if not (name and equals and value):
                raise ValueError(f"{text!r}: expected name=value after '?', got {item!r}")
            if name in parameters:
                raise ValueError(f"{text!r}: parameter {name!r} is given twice")
            parameters[name] = value
        return cls(target, tuple(sorted(parameters.items())))

    def __str__(self) -> str:
        query = "&".join(f"{name}={_canonical(value)}" for name, value in self.parameters)
        return f"{self.target}?{query}" if query else self.target


def canonical_problem(text: str) -> str:
    """Return a text that is the same for all ways to write the same problem specification.

    Files are made absolute, parameters sorted, numbers written one way.
    """
    specification = Specification.parse(text)
    path, colon, name = specification.target.rpartition(":")
    if colon and path.endswith(".py"):
        target = f"{Path(path).resolve()}:{name}"
        specification = Specification(target, specification.parameters)
    return str(specification)


def load_problem(text: str) -> Any:
    """Return the Problem that a specification names.

    Args:
      text: a shipped name ("pendulum"), "path/to/file.py:name" or "package.module:name", with
        parameters after "?" where the name is a function that returns a Problem.

    Raises:
      ValueError: if it names nothing, or something that is no Problem.
    """
    from swerve.problem import Problem

    specification = Specification.parse(text)
    target = SHIPPED.get(specification.target, specification.target)
    path, colon, name = target.rpartition(":")
    if not colon:
        raise ValueError(
            f"{text!r} is no problem: expected one of {', '.join(SHIPPED)}, a path/to/file.py:name "
            "or a package.module:name"
        )
    module = _load_file(Path(path)) if path.endswith(".py") else _load_module(path, text)
    if not hasattr(module, name):
        raise ValueError(f"{text!r}: {path} defines no {name!r}")
    found = getattr(module, name)
    if callable(found) and not isinstance(found, Problem):
        found = build(found, specification, text)
    elif specification.parameters:
        raise ValueError(
            f"{text!r}: {name!r} is a Problem, not a function that returns one, "
            "so it takes no parameters"
        )
    if not isinstance(found, Problem):
        raise ValueError(f"{text!r}: expected a swerve.Problem, got {type(found).__name__}")
    return found


def build(function: Callable[..., Any], specification: Specification, text: str) -> Any:
    """Call a function or class with a specification's parameters, converted to its types.

    Raises:
      ValueError: if it takes no such parameter, or a value is not of its type.
    """
    known = inspect.signature(function).parameters
    hints = get_type_hints(function)
    arguments = {}
    for name, value in specification.parameters:
        if name not in known:
            raise ValueError(
                f"{text!r}: no parameter {name!r}; there are {', '.join(known) or 'none'}"
            )
        try:
            arguments[name] = _convert(value, hints.get(name, str))
        except ValueError as error:
            raise ValueError(f"{text!r}: parameter {name!r}: {error}") from None
    missing = [
        name
        for name, parameter in known.items()
        if parameter.default is parameter.empty
        and name not in arguments
        and parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
    ]
    if missing:
        raise ValueError(f"{text!r}: parameters without a value: {', '.join(missing)}")
    return function(**arguments)


def source_hashes(problem: Any) -> dict[str, str]:
    """Return the hash of every source file outside installed packages that a problem came from.

    These are the files of all imported modules that are neither Swerve's nor installed, and of the
    classes that the MDP is made of.
    """
    modules = [
        module
        for name, module in sys.modules.items()
        if name != "__main__" and name.partition(".")[0] != "swerve"
    ]
    modules += [sys.modules[base.__module__] for base in type(problem.mdp).__mro__]
    files = {Path(str(module.__file__)) for module in modules if getattr(module, "__file__", None)}
    return {str(path): file_hash(path) for path in sorted(files) if _is_user_source(path)}


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file, or "missing"."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return "missing"


def _is_user_source(path: Path) -> bool:
    installed = [
        sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")
    ]
    return (
        path.suffix == ".py"
        and not {"site-packages", "dist-packages"} & set(path.parts)  # of users, of Debian
        and not any(path.is_relative_to(folder) for folder in installed)
    )


def _load_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise ValueError(f"{path}: no such file")
    path = path.resolve()
    sys.path.insert(0, str(path.parent))  # so that it can import its neighbours
    name = f"swerve_problem_{path.stem}"  # never the name of an installed module
    specification = importlib.util.spec_from_file_location(name, path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module
    specification.loader.exec_module(module)
    return module


def _load_module(name: str, text: str) -> ModuleType:
    if str(Path.cwd()) not in sys.path:  # as `python -m` has it
        sys.path.insert(0, str(Path.cwd()))
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise ValueError(f"{text!r}: {error}") from error


def _convert(value: str, hint: Any) -> Any:
    """Convert a text to the type that a signature asks for; of several, the first that fits."""
    kinds = [kind for kind in (get_args(hint) or (hint,)) if kind in (bool, int, float, str)]
    for kind in kinds or [str]:
        try:
            return _CONVERSIONS[kind](value)
        except ValueError:
            continue
    raise ValueError(f"expected {' or '.join(kind.__name__ for kind in kinds)}, got {value!r}")


def _bool(value: str) -> bool:
    if value.lower() not in ("true", "false"):
        raise ValueError
    return value.lower() == "true"


def _int(value: str) -> int:
    number = float(value)  # accepts 2e6
    if not number.is_integer():
        raise ValueError
    return int(number)


_CONVERSIONS: dict[type, Callable[[str], Any]] = {
    bool: _bool,
    int: _int,
    float: float,
    str: str,
}


def _canonical(value: str) -> str:
    try:
        number = float(value)
    except ValueError:
        return value
    return repr(number) if math.isfinite(number) else value
