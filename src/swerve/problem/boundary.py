"""Cast what the methods of an MDP return: float32 for numbers, booleans for endings.

Code that users write returns numbers of many kinds: float64 where JAX was told so, float16,
integers, booleans, Python's numbers, NumPy's arrays. Simulation is in float32, whatever they are.
So each method of an MDP is wrapped where its class is defined, and every caller gets the same kind.

Shapes: A actions, m action dimensions.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from swerve.base.space import Task
from swerve.base.user_code import untraceable

NUMBERS = ("dynamics", "reward", "terminal_reward", "features", "sample_state")
FLAGS = ("terminated",)
TASKS = ("sample_task",)


class BoundaryError(ValueError):
    """What a user's code returned cannot be cast."""


def cast_methods(mdp_class: type, base: type) -> None:
    """Wrap the methods of an MDP's class that it does not have from `base`, its abstract parent."""
    for name in (*NUMBERS, *FLAGS, *TASKS):
        owner = next((x for x in mdp_class.__mro__ if name in vars(x)), base)
        method = vars(owner).get(name)
        is_field = name in vars(mdp_class).get("__annotations__", {})
        if owner is not base and not is_field and not hasattr(method, "_casts"):
            setattr(mdp_class, name, _wrapped(method, name))


def _wrapped(method: Any, name: str) -> Callable[..., Any]:
    """Return a method whose result is cast."""
    cast = _flag if name in FLAGS else _task if name in TASKS else number

    @wraps(method)
    def wrapper(self: Any, *arguments: Any, **named: Any) -> Any:
        bound = method.__get__(self, type(self)) if hasattr(method, "__get__") else method
        origin = f"{type(self).__name__}.{name}"
        with np.errstate(over="ignore"):  # 1e300 becomes infinite, which guards may do
            try:
                value = bound(*arguments, **named)
            except Exception as error:
                mended = untraceable(error)
                if not mended:
                    raise
                raise BoundaryError(f"{origin}: {mended}") from error
            return cast(value, origin)

    vars(wrapper)["_casts"] = True
    return wrapper


def number(value: Any, origin: str) -> jax.Array:
    """Return real numbers of any kind as an array of float32.

    Raises:
      BoundaryError: naming the origin, if the value is complex, or not made of numbers.
    """
    return _real(value, origin).astype(jnp.float32)


def actions_of(mdp: Any) -> jax.Array:
    """Return the actions [A, m] as methods receive them: whole numbers stay whole, 32 bits each.

    Raises:
      BoundaryError: if the actions are complex, or not made of numbers.
    """
    array = _real(mdp.actions, f"{type(mdp).__name__}.actions")
    is_whole = jnp.issubdtype(array.dtype, jnp.integer)
    return array.astype(jnp.int32 if is_whole else jnp.float32)


def plain_array(value: Any) -> np.ndarray:
    """Return an array as one of NumPy's; a key of JAX's random numbers as the numbers it holds."""
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        value = jax.random.key_data(value)
    return np.asarray(value)


def _flag(value: Any, origin: str) -> jax.Array:
    """Return booleans, or numbers 0 and 1, as an array of booleans."""
    array = _real(value, origin)
    if not isinstance(array, Tracer) and not np.isin(array, (0, 1)).all():
        raise BoundaryError(f"{origin}: expected True or False, got {value} of {array.dtype}")
    return array.astype(bool)


def _task(value: Any, origin: str) -> Task:
    """Return a task with its start and its goal cast."""
    try:
        start, goal = value
    except (TypeError, ValueError) as error:
        text = f"{origin}: expected swerve.Task(start, goal), got {value!r}"
        raise BoundaryError(text) from error
    return Task(number(start, f"{origin}: start"), number(goal, f"{origin}: goal"))


def _real(value: Any, origin: str) -> jax.Array:
    """Return real numbers or booleans as an array."""
    try:
        array = jnp.asarray(value)
    except (TypeError, ValueError) as error:
        raise BoundaryError(f"{origin}: expected numbers, got {value!r}") from error
    if jnp.issubdtype(array.dtype, np.complexfloating):
        raise BoundaryError(
            f"{origin}: expected real numbers, got {array.dtype}: return the part that is meant, "
            "such as value.real"
        )
    if not (jnp.issubdtype(array.dtype, np.number) or array.dtype == bool):
        raise BoundaryError(f"{origin}: expected numbers, got {array.dtype}")
    return array
