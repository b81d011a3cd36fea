"""Say what to write where JAX cannot trace a function of a user, and in which line.

JAX is known by the names of its errors alone, so that this needs no JAX.
"""

from __future__ import annotations

import traceback

from swerve.base.imports import is_installed

ADVICE = {
    "TracerBoolConversionError": "use jnp.where, not if, and &, | and ~, not and, or and not",
    "TracerArrayConversionError": "use jax.numpy, not NumPy",
    "TracerIntegerConversionError": "use an array of jax.numpy, not an index into a list",
    "NonConcreteBooleanIndexError": "use jnp.where, not an index of booleans",
    "ConcretizationTypeError": "use jax.numpy, not float(), int() or range()",
}
"""What to write, by the name of the error."""

AMBIGUOUS = "The truth value of an array"  # begins the error of `if` on several values


def untraceable(error: Exception) -> str:
    """Return what to write in a user's function, and where, after an error of tracing.

    Args:
      error: an error that the function raised.

    Returns:
      The text that follows the name of the function in a message; '' for errors of other kinds.
    """
    kind = type(error).__name__
    if isinstance(error, ValueError) and str(error).startswith(AMBIGUOUS):
        kind = "TracerBoolConversionError"
    if kind not in ADVICE:
        return ""
    lines = [
        f"{frame.f_code.co_filename}, line {number}"
        for frame, number in traceback.walk_tb(error.__traceback__)
        if frame.f_globals.get("__name__", "").partition(".")[0] != "swerve"
        and not is_installed(frame.f_code.co_filename)
    ]
    place = f"; {lines[-1]}" if lines else ""
    return f"expected a function that JAX can trace, for all values at once{place}: {ADVICE[kind]}"
