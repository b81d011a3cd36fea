"""Functions written with jax.numpy as CasADi expressions, for solvers that need exact derivatives.

JAX traces a function of vectors into a list of elementary operations, the jaxpr. This module
applies each operation to arrays of CasADi scalars instead of numbers:

    arithmetic     one CasADi operation for each element,
    rearrangement  JAX moves the positions of the elements, then the elements are picked,
    calls, loops   their bodies in turn; loops of fixed length are unrolled.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any

import casadi
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

ELEMENTWISE: dict[str, Callable[..., Any]] = {
    "abs": casadi.fabs,
    "acos": casadi.acos,
    "add": operator.add,
    "add_any": operator.add,
    "and": casadi.logic_and,
    "asin": casadi.asin,
    "atan": casadi.atan,
    "atan2": casadi.atan2,
    "ceil": casadi.ceil,
    "cos": casadi.cos,
    "cosh": casadi.cosh,
    "div": operator.truediv,
    "eq": casadi.eq,
    "exp": casadi.exp,
    "expm1": casadi.expm1,
    "floor": casadi.floor,
    "ge": casadi.ge,
    "gt": casadi.gt,
    "le": casadi.le,
    "log": casadi.log,
    "log1p": casadi.log1p,
    "logistic": lambda value: 1.0 / (1.0 + casadi.exp(-value)),
    "lt": casadi.lt,
    "max": casadi.fmax,
    "min": casadi.fmin,
    "mul": operator.mul,
    "ne": casadi.ne,
    "neg": operator.neg,
    "not": casadi.logic_not,
    "or": casadi.logic_or,
    "pow": operator.pow,
    "rem": casadi.fmod,
    "rsqrt": lambda value: 1.0 / casadi.sqrt(value),
    "select_n": lambda which, *cases: casadi.if_else(which, cases[1], cases[0]),
    "sign": casadi.sign,
    "sin": casadi.sin,
    "sinh": casadi.sinh,
    "sqrt": casadi.sqrt,
    "square": lambda value: value * value,
    "sub": operator.sub,
    "tan": casadi.tan,
    "tanh": casadi.tanh,
}
SAME = ("copy", "reduce_precision", "stop_gradient")  # operations that return their operand
NOT_OF_INTEGERS = ("and", "div", "not", "or")  # differ from CasADi's operations on integers
REARRANGING = (
    "broadcast_in_dim",
    "concatenate",
    "dynamic_slice",
    "expand_dims",
    "gather",
    "reshape",
    "rev",
    "slice",
    "split",
    "squeeze",
    "stack",
    "transpose",
)
REDUCING: dict[str, Callable[[Any, Any], Any]] = {
    "reduce_max": casadi.fmax,
    "reduce_min": casadi.fmin,
    "reduce_prod": operator.mul,
    "reduce_sum": operator.add,
}
PLACES = {"gather": 1, "dynamic_slice": 1}  # number of the first operand that is a position
INNER = ("jaxpr", "call_jaxpr", "fun_jaxpr")  # options of a call that hold the called function


def as_casadi(function: Callable[..., Any], sizes: Sequence[int], label: str) -> casadi.Function:
    """Return a function of vectors, written with jax.numpy, as a CasADi function.

    Args:
      function: maps vectors to one array of numbers, which is flattened.
      sizes: lengths of the vectors.
      label: name of the function in messages.

    Raises:
      ValueError: if the function uses an operation without a CasADi expression.
    """
    shapes = [jax.ShapeDtypeStruct((size,), jnp.float32) for size in sizes]
    closed = jax.make_jaxpr(function)(*shapes)
    symbols = [casadi.SX.sym(f"x{k}", size) for k, size in enumerate(sizes)]
    arguments = [_elements(symbol, size) for symbol, size in zip(symbols, sizes, strict=True)]
    try:
        (value,) = _evaluate(closed.jaxpr, closed.consts, arguments)
    except NotImplementedError as error:
        raise ValueError(
            f"{label}: expected operations of jax.numpy that have exact derivatives, but it uses "
            f"{error}: write it with arithmetic, jnp.where and loops of a fixed length"
        ) from None
    return casadi.Function("f", symbols, [casadi.vertcat(*_array(value).ravel().tolist())])


def _elements(symbol: casadi.SX, size: int) -> np.ndarray:
    """Return the elements of a CasADi vector as an array."""
    return _objects([symbol[k] for k in range(size)], (size,))


def _objects(values: Sequence[Any], shape: tuple[int, ...]) -> np.ndarray:
    """Return an array of CasADi scalars and numbers."""
    array = np.empty(len(values), object)
    for k, value in enumerate(values):
        array[k] = value
    return array.reshape(shape)


def _evaluate(jaxpr: Jaxpr, constants: Sequence[Any], arguments: Sequence[Any]) -> list[Any]:
    """Return the results of a jaxpr applied to arrays of numbers or of CasADi scalars."""
    known: dict[Any, Any] = {}

    def read(variable: Any) -> Any:
        return variable.val if isinstance(variable, Literal) else known[variable]

    known.update(zip(jaxpr.constvars, constants, strict=True))
    known.update(zip(jaxpr.invars, arguments, strict=True))
    for step in jaxpr.eqns:
        values = _apply(step, [read(variable) for variable in step.invars])
        known.update(zip(step.outvars, values, strict=True))
    return [read(variable) for variable in jaxpr.outvars]


def _apply(step: Any, operands: list[Any]) -> Sequence[Any]:
    """Return the results of one operation.

    Raises:
      NotImplementedError: with the operation's name, if it has no CasADi expression.
    """
    name, options = step.primitive.name, step.params
    if not any(_is_symbolic(operand) for operand in operands):
        results = step.primitive.bind(*operands, **options)
        return results if step.primitive.multiple_results else [results]
    if name in NOT_OF_INTEGERS and _is_integer(step.invars[0]):
        raise NotImplementedError(f"{name} of integers")
    if name == "select_n" and len(operands) > 3:
        raise NotImplementedError("a choice of more than two cases")
    if name == "convert_element_type":
        return [_converted(step, operands[0])]
    if name == "round":
        return [_elementwise(ROUNDING[options["rounding_method"]], operands)]
    if name in ELEMENTWISE:
        return [_elementwise(ELEMENTWISE[name], operands)]
    if name == "integer_pow":
        return [_elementwise(lambda value: value ** options["y"], operands)]
    if name in SAME:
        return operands[:1]
    if name in REARRANGING:
        return _rearranged(step, operands)
    if name in REDUCING:
        axes = tuple(options["axes"])
        return [_reduced(REDUCING[name], _array(operands[0]), axes)]
    if name == "dot_general":
        return [_product(*map(_array, operands), *options["dimension_numbers"])]
    if name == "scan":
        return _scanned(operands, **options)
    inner = next((options[key] for key in INNER if key in options), None)
    if isinstance(inner, ClosedJaxpr):
        return _evaluate(inner.jaxpr, inner.consts, operands)
    raise NotImplementedError(name)


def _is_symbolic(operand: Any) -> bool:
    """Return whether an operand is an array of CasADi scalars."""
    return isinstance(operand, np.ndarray) and operand.dtype == object


def _array(operand: Any) -> np.ndarray:
    """Return an operand as an array of CasADi scalars and numbers."""
    if _is_symbolic(operand):
        return operand
    numbers = np.asarray(operand)
    return _objects(numbers.ravel().tolist(), numbers.shape)


def _elementwise(function: Callable[..., Any], operands: Sequence[Any]) -> np.ndarray:
    """Return the values of a function of scalars for each element of broadcast operands."""
    arrays = np.broadcast_arrays(*map(_array, operands))
    values = [function(*items) for items in zip(*(a.ravel() for a in arrays), strict=True)]
    return _objects(values, arrays[0].shape)


def _is_integer(variable: Any) -> bool:
    """Return whether a variable of a jaxpr holds integers."""
    return bool(np.issubdtype(variable.aval.dtype, np.integer))


def _converted(step: Any, operand: np.ndarray) -> np.ndarray:
    """Return numbers as another type: to integers by truncation, to truth values by `!= 0`."""
    before, after = step.invars[0].aval.dtype, step.params["new_dtype"]
    if np.issubdtype(after, np.integer) and np.issubdtype(before, np.floating):
        return _elementwise(lambda x: casadi.sign(x) * casadi.floor(casadi.fabs(x)), [operand])
    if after == np.bool_ and before != np.bool_:
        return _elementwise(lambda x: casadi.ne(x, 0.0), [operand])
    return operand


def _to_even(value: Any) -> Any:
    """Round to the nearest whole number, halves to the even one."""
    below = casadi.floor(value)
    part, is_odd = value - below, casadi.ne(casadi.fmod(below, 2.0), 0.0)
    return below + casadi.logic_or(part > 0.5, casadi.logic_and(casadi.eq(part, 0.5), is_odd))


def _away(value: Any) -> Any:
    """Round to the nearest whole number, halves away from 0."""
    return casadi.sign(value) * casadi.floor(casadi.fabs(value) + 0.5)


ROUNDING = {
    jax.lax.RoundingMethod.TO_NEAREST_EVEN: _to_even,
    jax.lax.RoundingMethod.AWAY_FROM_ZERO: _away,
}


def _rearranged(step: Any, operands: Sequence[Any]) -> list[np.ndarray]:
    """Return the elements in a new order, found by applying the operation to positions."""
    name = step.primitive.name
    first = PLACES.get(name, len(operands))
    pool: list[Any] = []
    moved = []
    for operand in operands[:first]:
        items = _array(operand)
        moved.append(jnp.arange(len(pool), len(pool) + items.size).reshape(items.shape))
        pool += items.ravel().tolist()
    if any(_is_symbolic(operand) for operand in operands[first:]):
        raise NotImplementedError(f"{name} at a place that depends on its arguments")
    results = step.primitive.bind(*moved, *operands[first:], **step.params)
    results = results if step.primitive.multiple_results else [results]
    return [_objects([pool[k] for k in np.ravel(place)], place.shape) for place in results]


def _reduced(
    function: Callable[[Any, Any], Any], array: np.ndarray, axes: tuple[int, ...]
) -> np.ndarray:
    """Return an array with some axes reduced by a function of two values."""
    kept = [axis for axis in range(array.ndim) if axis not in axes]
    shape = tuple(array.shape[axis] for axis in kept)
    rows = array.transpose(*kept, *axes).reshape(int(np.prod(shape)), -1)
    return _objects([functools.reduce(function, row) for row in rows], shape)


def _product(left: np.ndarray, right: np.ndarray, summed: Any, batched: Any) -> np.ndarray:
    """Return a product of matrices or vectors; `summed` holds the axes of each to sum over."""
    if any(len(axes) for axes in batched):
        raise NotImplementedError("a batched dot_general")
    return np.asarray(np.tensordot(left, right, summed), object)


def _scanned(
    operands: list[Any],
    *,
    jaxpr: ClosedJaxpr,
    length: int,
    reverse: bool,
    num_consts: int,
    num_carry: int,
    **_: Any,
) -> list[Any]:
    """Return the last carry and the stacked outputs of a loop of fixed length, unrolled."""
    fixed, carry = operands[:num_consts], operands[num_consts : num_consts + num_carry]
    rows = operands[num_consts + num_carry :]
    outputs = []
    for k in range(length)[:: -1 if reverse else 1]:
        now = [row[k : k + 1].reshape(row.shape[1:]) for row in rows]
        results = _evaluate(jaxpr.jaxpr, jaxpr.consts, [*fixed, *carry, *now])
        carry = results[:num_carry]
        outputs.append([_array(result) for result in results[num_carry:]])
    stacked = [np.stack(column) for column in zip(*outputs[:: -1 if reverse else 1], strict=True)]
    return [*carry, *stacked]
