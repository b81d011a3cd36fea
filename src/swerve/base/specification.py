"""Read texts that name a thing and its parameters: "pendulum?max_torque=10", "robot.py:problem".

A specification is a target and parameters, `target?name=value&name=value`. Each parameter is
converted to its type in the target's signature: the type of the annotation or, without one, the
type of the default.
"""

from __future__ import annotations

import builtins
import inspect
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from types import SimpleNamespace
from typing import Any, get_args, get_type_hints

from swerve.base.decimals import decimal_number, whole_decimal

# matches 10, 10.0, 1e1, .5 and so on; not 007, 1.10, +7 or 1_000, which may be texts
PLAIN_NUMBER = re.compile(
    r"-?((0|[1-9][0-9]*)(\.0|\.[0-9]*[1-9])?|\.[0-9]*[1-9])(e[+-]?[0-9]{1,3})?", re.IGNORECASE
)


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


def build(function: Callable[..., Any], specification: Specification, text: str) -> Any:
    """Call a function or class with a specification's parameters, converted to its types.

    Where the annotation of a parameter is missing or exists for type checkers alone, the parameter
    has the type of its default. Without a default, the parameter is a text.

    Raises:
      ValueError: if the function has no such parameter, or a value is not of the parameter's type.
    """
    known = inspect.signature(function).parameters
    arguments = {}
    for name, value in specification.parameters:
        if name not in known:
            raise ValueError(
                f"{text!r}: no parameter {name!r}; there are {', '.join(known) or 'none'}"
            )
        try:
            arguments[name] = _convert(value, function, known[name])
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


def _convert(value: str, function: Callable[..., Any], parameter: inspect.Parameter) -> Any:
    """Convert a text to the type of a parameter; where it has several, to the first that fits."""
    hint, remark = _annotation(function, parameter), ""
    options = (hint,) if hint in list(_CONVERSIONS) else get_args(hint)
    kinds = [kind for kind in options if kind in list(_CONVERSIONS)]
    if not kinds:
        kinds = [kind for kind in (bool, int, float, str) if isinstance(parameter.default, kind)][
            :1
        ]
        remark = f": its default is {parameter.default!r}"
        if kinds == [int]:
            remark += ", so annotate it as float if it may have fractions"
    for kind in kinds or [str]:
        try:
            return _CONVERSIONS[kind](value)
        except ValueError:
            continue
    expected = " or ".join(str(kind) if get_args(kind) else kind.__name__ for kind in kinds)
    raise ValueError(f"expected {expected}, got {value!r}{remark}")


def _annotation(function: Callable[..., Any], parameter: inspect.Parameter) -> Any:
    """Return a parameter's annotation; None if it is missing or cannot be resolved.

    Annotations are resolved one by one: an annotation that names an import for type checkers alone
    does not spoil the other annotations.
    """
    if parameter.annotation is parameter.empty:
        return None
    holder = SimpleNamespace(__annotations__={"it": parameter.annotation})
    for namespace in _namespaces(function):
        try:
            return get_type_hints(holder, namespace)["it"]
        except Exception:  # whatever a user's annotation may raise
            continue
    return None


def _namespaces(function: Callable[..., Any]) -> list[dict[str, Any]]:
    """Return the namespaces of a signature's names; for a class, those of all its bases."""
    if isinstance(function, type):
        return [vars(sys.modules.get(base.__module__, builtins)) for base in function.__mro__]
    inner = getattr(function, "func", function)  # the function inside a functools.partial
    return [getattr(inspect.unwrap(inner), "__globals__", {})]


def _ints(value: str) -> tuple[int, ...]:
    """Return whole numbers separated by commas; raise ValueError for a single number."""
    if "," not in value:
        raise ValueError
    return tuple(whole_decimal(part) for part in value.split(","))


def _floats(value: str) -> tuple[float, ...]:
    return tuple(_float(part) for part in value.split(","))


def _bool(value: str) -> bool:
    if value.lower() not in ("true", "false"):
        raise ValueError
    return value.lower() == "true"


def _float(value: str) -> float:
    """Return a number, which may be infinite."""
    return float(value) if value in ("inf", "-inf") else decimal_number(value)


_CONVERSIONS: dict[Any, Callable[[str], Any]] = {
    tuple[int, ...]: _ints,
    tuple[float, ...]: _floats,
    bool: _bool,
    int: whole_decimal,
    float: _float,
    str: str,
}


def _canonical(value: str) -> str:
    if not PLAIN_NUMBER.fullmatch(value):
        return value
    number = repr(float(value)).removesuffix(".0")
    return number if Decimal(number) == Decimal(value) else value
