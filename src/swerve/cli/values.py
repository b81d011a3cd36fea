"""Read the texts that options hold: numbers by one grammar, paths and names that are not empty."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, get_args

import cyclopts
from cyclopts import CoercionError

from swerve.base.decimals import decimal_number, whole_decimal


def convert(kind: Any, tokens: Any) -> Any:
    """Convert the texts of an option to its type; a wrong text ends the command."""
    if dict[str, float] in (kind, *get_args(kind)) and not isinstance(tokens, dict):
        got = tokens[0].value
        message = f"expected a state and its margin, as in --margin.x 0.05, got {got!r} alone"
        raise CoercionError(msg=message)
    return cyclopts.convert(kind, tokens, converter=_convert_one)


def convert_limit(kind: Any, tokens: Any) -> float:
    """Convert the text of an option that may be inf, for no limit."""
    del kind
    (token,) = tokens
    if token.value == "inf":
        return math.inf
    try:
        return _convert_one(float, token.value)
    except CoercionError as error:
        error.token = token  # for the name of the option in the message
        raise


def _convert_one(kind: Any, text: str) -> Any:
    try:
        if kind is float:
            return decimal_number(text)
        if kind is int:
            return whole_decimal(text)
        if kind in (str, Path):
            _check_text(text, "a path, where . is the current folder" if kind is Path else "a name")
    except ValueError as error:
        raise CoercionError(msg=str(error), target_type=kind) from None
    return cyclopts.convert(kind, [text])


def _check_text(text: str, expected: str) -> None:
    """Raise ValueError if a text names nothing: an empty path would be the current folder."""
    if not text.strip() or "\0" in text:
        raise ValueError(f"expected {expected}, got {text!r}")
