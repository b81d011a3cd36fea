"""Errors of tracing, told by the line of the user and what to write there."""

from __future__ import annotations

import pytest

from swerve.base.user_code import untraceable


def test_other_errors_are_left_as_they_are() -> None:
    for error in (ValueError("expected low < high"), KeyError("a"), TypeError("takes 2")):
        assert untraceable(error) == ""


def test_the_last_line_of_the_user_is_named() -> None:
    """Not that of Swerve, nor that of an installed package, which are called from there."""
    with pytest.raises(ValueError, match="truth value") as caught:
        _branch()
    line = _branch.__code__.co_firstlineno + 3
    assert untraceable(caught.value).startswith(
        f"expected a function that JAX can trace, for all values at once; {__file__}, line {line}: "
        "use jnp.where, not if"
    )


def _branch() -> bool:
    import numpy as np

    return bool(np.arange(2) > 0)
