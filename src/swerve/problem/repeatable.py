"""Check that the code of a problem gives the same answer twice.

JAX calls a method once, when it traces it, and repeats what it has seen: a counter or a random
number of Python becomes a constant, and the model another with each trace. A predicate that judges
at random would judge nominal trajectories and demonstrations differently.

Shapes: n state dimensions.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, jaxpr_as_fun

from swerve.base.space import StateSpace
from swerve.constraints.base import Constraint
from swerve.problem.boundary import actions_of, plain_array

NUM_STATES = 256  # states on which a predicate is tried
GOLDEN = 0.6180339887  # its multiples are spread evenly, and hit no round number
ROUNDING = 1e-4  # relative difference that compiling may make
NUM_TRACES = 7  # and a call: a coin falls on the same side so many times in 1 of 128 cases
EDGES = 0.02  # share of the states that NumPy and JAX may judge differently: those on edges
REMEDY = (
    "expected a function of its arguments alone. Take counters, random numbers (numpy.random, "
    "random) and clocks out: the dynamics of an MDP are deterministic"
)
OWN = "swerve.systems."  # modules of systems that the tests check
_CHECKED: WeakKeyDictionary[type, set[str]] = WeakKeyDictionary()  # digests of MDPs, by class
_JUDGED: WeakKeyDictionary[Constraint, bytes] = WeakKeyDictionary()  # bounds, by predicate


def check_repeatable(mdp: Any, digest: str) -> None:
    """Raise ValueError where a method of an MDP does not depend on its arguments alone.

    Args:
      mdp: the MDP; one of the same class and digest is checked once, Swerve's own never.
      digest: hash of the MDP's class, parameters and actions.
    """
    checked = _CHECKED.setdefault(type(mdp), set())
    if digest in checked or type(mdp).__module__.startswith(OWN):
        return
    space, name = mdp.space, type(mdp).__name__
    state, next_state = (_somewhere(space, k) for k in (1, 2))
    goal = _somewhere(space, 3)
    if tuple(mdp.goal_names) != tuple(mdp.state_names):
        goal = jnp.full(len(mdp.goal_names), GOLDEN, jnp.float32)
    action = actions_of(mdp)[-1]
    for label, method, arguments in (
        ("dynamics", mdp.dynamics, (state, action)),
        ("reward", mdp.reward, (state, action, next_state, goal)),
        ("terminal_reward", mdp.terminal_reward, (state, goal)),
        ("terminated", mdp.terminated, (state, goal)),
        ("features", mdp.features, (state, jnp.int32(1), goal)),
    ):
        _check_method(f"{name}.{label}", method, arguments)
    checked.add(digest)


def check_predicates(constraints: Iterable[Constraint], space: StateSpace, what: str) -> None:
    """Raise ValueError where a predicate judges the same states in two ways.

    Args:
      constraints: constraints of any kind; those without code are left out, and those that were
        checked in the same bounds before.
      space: state space.
      what: "hypotheses" or "known", for messages.
    """
    low, high = space.bounds.T
    states = np.random.default_rng(0).uniform(low, high, (NUM_STATES, len(low)))
    states = states.astype(np.float32)
    for constraint in constraints:
        for part in constraint.parts if constraint.needs_code else ():
            if part.needs_code and _JUDGED.get(part) != space.bounds.tobytes():
                _check_predicate(part, states, space, what)
                _JUDGED[part] = space.bounds.tobytes()


def _check_predicate(part: Constraint, states: np.ndarray, space: StateSpace, what: str) -> None:
    first, second = (np.asarray(part.contains(states, space)) for _ in range(2))
    if (first != second).any():
        raise ValueError(
            f"{what}: {part.name!r}, asked twice, judged {np.count_nonzero(first != second)} of "
            f"{len(states)} states differently: expected a function of the states alone"
        )
    try:
        traced = np.asarray(part.contains(jnp.asarray(states), space))
    except Exception:  # of NumPy alone: that is told where JAX has to call it
        return
    differs = np.count_nonzero(first != traced)
    if differs > EDGES * len(states):
        raise ValueError(
            f"{what}: {part.name!r} judged {differs} of {len(states)} states differently as a "
            "NumPy array and as a JAX array: expected the same answer"
        )


def _somewhere(space: StateSpace, k: int) -> jax.Array:
    """Return a state in the bounds at which no term is likely to vanish."""
    share = 0.1 + 0.8 * (GOLDEN * (k + 3 * np.arange(len(space.names))) % 1.0)
    return jnp.asarray(space.bounds[:, 0] + share * space.extent, jnp.float32)


def _check_method(label: str, method: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """Call a method, trace it several times, and compare.

    It is called as seldom as can be: JAX compiles a loop anew with each call.
    """

    def call() -> np.ndarray:
        return np.asarray(method(*arguments), float)

    def trace() -> Any:
        return jax.make_jaxpr(lambda *given: method(*given))(*arguments)  # noqa: PLW0108  # traced anew

    first, program = call(), trace()
    known = _Program.of(program)
    if not all(known.is_same(_Program.of(trace())) for _ in range(NUM_TRACES - 1)):
        again = call()
        if np.array_equal(first, again, equal_nan=True):
            found = "traced twice by JAX, it gave two different programs"
        else:
            found = (
                "called twice with the same arguments, it returned "
                f"{first.tolist()} and {again.tolist()}"
            )
        raise ValueError(f"{label}: {found}: {REMEDY}")
    with np.errstate(over="ignore"):  # as where the boundary calls the method
        traced = np.asarray(jaxpr_as_fun(program)(*arguments)[0])
    if not np.allclose(traced.astype(float), first, ROUNDING, ROUNDING, equal_nan=True):
        raise ValueError(
            f"{label}: it returned {first.tolist()}, and traced by JAX {traced.tolist()}: {REMEDY}"
        )


class _Program(NamedTuple):
    """What two traced programs are compared by: their texts, and their constants."""

    text: str
    constants: list[np.ndarray]

    @classmethod
    def of(cls, program: Any) -> _Program:
        """Return the text, less addresses, and the constants of a traced program."""
        text = re.sub("0x[0-9a-f]+", "", str(program))
        return cls(text, [plain_array(constant) for constant in _constants(program)])

    def is_same(self, other: _Program) -> bool:
        """Return whether two programs have the same text and the same constants."""
        if self.text != other.text or len(self.constants) != len(other.constants):
            return False
        pairs = zip(self.constants, other.constants, strict=True)
        return all(np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in pairs)


def _constants(program: Any) -> Iterator[Any]:
    """Yield the constants of a traced program and of the programs inside it, as of loops."""
    yield from getattr(program, "consts", ())
    for equation in program.eqns:
        for leaf in jax.tree.leaves(equation.params):
            if isinstance(leaf, ClosedJaxpr | Jaxpr):
                yield from _constants(leaf)
