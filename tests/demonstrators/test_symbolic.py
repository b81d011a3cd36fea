"""CasADi expressions have the values and derivatives of the JAX functions they are made from."""

from __future__ import annotations

from collections.abc import Callable

import casadi
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swerve.demonstrators.symbolic import as_casadi
from swerve.systems.car import Car
from swerve.systems.double_pendulum import DoublePendulum
from swerve.systems.pendulum import Pendulum
from swerve.systems.walker import Walker

X, Y = np.array([0.3, -1.2, 2.1]), np.array([0.4, 0.5])
MATRIX = jnp.array([[1.0, 2.0, 3.0], [0.0, 1.0, 2.0]])


def loop(x: jax.Array, y: jax.Array) -> jax.Array:
    last, passed = jax.lax.scan(lambda c, row: (c * 0.5 + row.sum(), c), x[0], jnp.stack([x, -x]))
    back = jax.lax.scan(lambda c, v: (c + v**2, c * v), y[0], x, reverse=True)[1]
    counted = jax.lax.fori_loop(0, 3, lambda k, v: jnp.sin(v) + k, y)
    return jnp.concatenate([passed, last[None], back, counted])


FUNCTIONS: dict[str, Callable[[jax.Array, jax.Array], jax.Array]] = {
    "arithmetic": lambda x, y: -x * 2.0 / (x + 3.0) ** 3 - y[0] ** 2.5 + 1.0 / jnp.sqrt(y[1]),
    "functions": lambda x, y: jnp.concatenate(
        [
            jnp.tanh(x),
            jnp.exp(x),
            jnp.arctan2(x, x + 1.0),
            jnp.log1p(y),
            jnp.expm1(y),
            jax.nn.sigmoid(x),
            jnp.arcsin(y),
            jnp.cosh(x),
        ]
    ),
    "rounding": lambda x, y: jnp.concatenate(
        [x % 2.0, jnp.remainder(x, -1.5), jnp.floor(x), jnp.ceil(y), jnp.round(x), jnp.sign(x)]
    ),
    "halves": lambda x, y: jnp.round(jnp.array([0.5, 1.5, -0.5, 2.5]) + 0.0 * x[0]),
    "conversions": lambda x, y: x.astype(jnp.int32) * 0.5 + (x > 0.0).astype(float) * x,
    "cases": lambda x, y: jnp.where((x > 0.0) & ~(x > y[0] + 1.0), x**2, jnp.abs(x)),
    "limits": lambda x, y: jnp.stack([x.max(), x.min(), x.prod(), jnp.clip(x[1], -0.1, 0.1)]),
    "matrices": lambda x, y: jnp.concatenate(
        [MATRIX @ x, jnp.outer(x, y).T.ravel(), x[:2] @ MATRIX]
    ),
    "rearrangement": lambda x, y: jnp.concatenate(
        [x[::-1], x[jnp.array([2, 0])], jnp.stack([x, x], 1).reshape(-1)[1:4], jnp.roll(x, 1), y]
    ),
    "library": lambda x, y: jnp.concatenate(
        [jax.nn.softplus(x), jax.nn.relu(x), jnp.hypot(x, x), jnp.linalg.norm(y)[None]]
    ),
    "loop": loop,
    "constants": lambda x, y: jnp.array([1.0, 2.0]) @ MATRIX * jnp.arange(3),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_values_and_derivatives(name: str) -> None:
    function = FUNCTIONS[name]
    made = as_casadi(function, (3, 2), name)
    value = function(jnp.asarray(X), jnp.asarray(Y))
    np.testing.assert_allclose(made(X, Y).full().ravel(), np.ravel(value), rtol=1e-5, atol=1e-6)
    x, y = casadi.SX.sym("x", 3), casadi.SX.sym("y", 2)
    slope = casadi.Function("slope", [x, y], [casadi.jacobian(made(x, y), x)])
    expected = jax.jacobian(function)(jnp.asarray(X), jnp.asarray(Y))
    np.testing.assert_allclose(slope(X, Y).full(), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda x: MATRIX[0][jnp.floor(x).astype(int)] * x, "gather at a place that depends"),
        (lambda x: jax.lax.dynamic_slice(x, (x[0].astype(int),), (1,)), "dynamic_slice at a place"),
        (lambda x: (x.astype(int) & 1) * x, "and of integers"),
        (lambda x: (x.astype(int) // 2) * x, "div of integers"),
        (lambda x: jax.lax.select_n(x.astype(int), x, x, -x), "more than two cases"),
        (lambda x: jnp.sort(x), "sort"),
    ],
)
def test_what_has_no_expression_is_refused_not_done_wrong(
    function: Callable[[jax.Array], jax.Array], message: str
) -> None:
    with pytest.raises(ValueError, match=f"friction: expected .*{message}"):
        as_casadi(function, (3,), "friction")


@pytest.mark.parametrize("mdp", [Pendulum(10.0), Car(), DoublePendulum(), Walker()])
def test_systems_that_come_along(mdp) -> None:
    sizes = len(mdp.state_names), len(mdp.action_names), len(mdp.goal_names)
    n, m, g = sizes
    generator = np.random.default_rng(0)
    for label, some in (
        ("dynamics", (n, m)),
        ("reward", (n, m, n, g)),
        ("terminal_reward", (n, g)),
    ):
        function = getattr(mdp, label)
        made = as_casadi(function, some, label)
        for _ in range(5):
            arguments = [generator.normal(size=size) * 3.0 for size in some]
            expected = function(*(jnp.asarray(value, jnp.float32) for value in arguments))
            np.testing.assert_allclose(
                made(*arguments).full().ravel(), np.ravel(expected), rtol=1e-4, atol=1e-4
            )


def test_what_cannot_be_written_so_is_named() -> None:
    def endless(x: jax.Array) -> jax.Array:
        return jax.lax.while_loop(lambda v: v.sum() < 10.0, lambda v: v * 2.0, x)

    with pytest.raises(ValueError, match=r"Robot.dynamics: expected .* but it uses while: write"):
        as_casadi(endless, (3,), "Robot.dynamics")
