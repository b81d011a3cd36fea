"""Define deterministic Markov decision processes with a goal: the model that all solvers work on.

A trajectory xi = (s_0, a_0, s_1, ..., s_L) follows s_{t+1} = f(s_t, a_t) for at most T steps of dt
seconds and earns

    R(xi) = sum_t r(s_t, a_t, s_{t+1}) + r_T(s_L),

where r_T is paid at the end of the episode: at t = T, or earlier where `terminated` is true.

Shapes: n state dimensions, m action dimensions, A actions, T steps, g goal dimensions,
F features. All methods work on one state; solvers map them over batches.
"""

import abc
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from swerve.base.arguments import number_or_nan, real_numbers, whole_number
from swerve.base.forked import check_process
from swerve.base.space import StateSpace, Task
from swerve.problem.boundary import BoundaryError, actions_of, cast_methods


class _StateNames:
    """The default of `goal_names`: the names of the states.

    A property cannot serve: a property takes precedence over a field of the same name in a
    subclass. This descriptor leaves precedence to the instance's own value, and gives the field no
    default.
    """

    def __get__(self, mdp: Any, owner: type) -> tuple[str, ...]:
        if mdp is None:
            raise AttributeError(f"{owner.__name__}.goal_names needs an instance")
        return mdp.state_names


class MDP(eqx.Module):
    """A demonstrator's possible actions and its reward; subclass it for your own system.

    A subclass sets the attributes, as class attributes, fields or properties, and defines
    `dynamics` and `reward`; the other methods have defaults.

    Attributes:
      state_names: the n names of the states, which are also the columns of demonstration files.
      action_names: the m names of the action's components.
      actions: [A, m] the actions to choose from.
      dt: duration of a step [s].
      num_steps: T, the horizon.
      bounds: [n, 2] where states are expected; grids, checks and random states use the bounds.
      angles: names of the states that wrap at 2 pi [rad]; none unless set.
      goal_names: the g names of the goal's components; the names of the states unless set.
      is_timed: whether every step takes dt seconds. False for a model without a clock, whose moves
        take no definite time, such as moves over a lattice: then demonstrations may be as slow or
        as quick as they like, and dt is only used where pictures and monitors need a time.
    """

    if TYPE_CHECKING:  # a type checker accepts any way in which a subclass provides the value
        state_names: Any = eqx.field(init=False)
        action_names: Any = eqx.field(init=False)
        actions: Any = eqx.field(init=False)
        dt: Any = eqx.field(init=False)
        num_steps: Any = eqx.field(init=False)
        bounds: Any = eqx.field(init=False)
        angles: Any = eqx.field(init=False)
        goal_names: Any = eqx.field(init=False)
        is_timed: Any = eqx.field(init=False)
    else:
        state_names: eqx.AbstractVar[tuple[str, ...]]
        action_names: eqx.AbstractVar[tuple[str, ...]]
        actions: eqx.AbstractVar[Float[Array, "A m"]]
        dt: eqx.AbstractVar[float]
        num_steps: eqx.AbstractVar[int]
        bounds: eqx.AbstractVar[Sequence[Sequence[float]]]
        angles = ()
        goal_names = _StateNames()
        is_timed = True

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cast_methods(cls, MDP)

    @abc.abstractmethod
    def dynamics(self, state: Float[Array, " n"], action: Float[Array, " m"]) -> Float[Array, " n"]:
        """Return the state one step later; angles need not be wrapped."""

    @abc.abstractmethod
    def reward(
        self,
        state: Float[Array, " n"],
        action: Float[Array, " m"],
        next_state: Float[Array, " n"],
        goal: Float[Array, " g"],
    ) -> Float[Array, ""]:
        """Return r(s, a, s'), the reward of one step."""

    def terminal_reward(
        self, state: Float[Array, " n"], goal: Float[Array, " g"]
    ) -> Float[Array, ""]:
        """Return r_T(s), paid where the episode ends, early or not; 0 unless overridden."""
        return jnp.zeros((), jnp.float32)

    def terminated(self, state: Float[Array, " n"], goal: Float[Array, " g"]) -> Bool[Array, ""]:
        """Return whether the episode ends on reaching this state; False unless overridden."""
        return jnp.zeros((), bool)

    def goal_of(self, states: Float[np.ndarray, "L n"]) -> Float[np.ndarray, " g"]:
        """Return the goal [g] of a finished demonstration without a stated goal: its last state."""
        return states[-1]

    def features(
        self, state: Float[Array, " n"], step: Int[Array, ""], goal: Float[Array, " g"]
    ) -> Float[Array, " F"]:
        """Return a network's inputs, of about unit scale, for a state, the step t and the goal.

        By default, the inputs are the state and its difference to the goal in units of half the
        bounds' extent (angles as sine and cosine), the goal itself, and the time to go.
        """
        space = self.space
        centre = space.bounds.mean(axis=1).astype(np.float32)
        half = (0.5 * space.extent).astype(np.float32)
        to_go = (self.num_steps - jnp.asarray(step, jnp.float32)) / self.num_steps
        parts = [_embed(state, centre, half, space.is_angle), jnp.stack([to_go, jnp.sqrt(to_go)])]
        if self.goal_names == self.state_names:
            parts.append(_embed(goal, centre, half, space.is_angle))
            parts.append(space.difference(state, goal) / half)
        else:
            parts.append(goal)
        return jnp.concatenate(parts)

    def sample_task(self, key: Key[Array, ""]) -> Task:
        """Sample a task to train for; by default start and goal are uniform in the bounds."""
        if self.goal_names != self.state_names:
            raise ValueError(
                f"{type(self).__name__} has goals {self.goal_names} that are not states: "
                "define sample_task(self, key) to return swerve.Task(start, goal)"
            )
        key_start, key_goal = jax.random.split(key)
        return Task(MDP.sample_state(self, key_start), MDP.sample_state(self, key_goal))

    def sample_state(self, key: Key[Array, ""]) -> Float[Array, " n"]:
        """Sample a state from which training may start; by default uniform in the bounds."""
        low, high = self.space.bounds.astype(np.float32).T
        return jax.random.uniform(key, low.shape, jnp.float32, low, high)

    @property
    def space(self) -> StateSpace:
        """The state space: names, angles, bounds."""
        return StateSpace(
            tuple(self.state_names), tuple(self.angles), np.asarray(self.bounds, float)
        )

    @property
    def num_actions(self) -> int:
        """A, the number of actions."""
        return len(self.actions)


def rk4(derivative, state: Array, dt: float) -> Array:
    """Integrate state' = derivative(state) over dt by the classical Runge-Kutta method."""
    k1 = derivative(state)
    k2 = derivative(state + 0.5 * dt * k1)
    k3 = derivative(state + 0.5 * dt * k2)
    k4 = derivative(state + dt * k3)
    return state + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def check_mdp(mdp: MDP) -> None:
    """Check shapes and values of an MDP by trying its methods on one state.

    Raises:
      ValueError: naming the attribute or method, the expected value and the actual value.
    """
    check_process()
    name = type(mdp).__name__
    for label in ("state_names", "action_names", "angles", "goal_names"):
        if isinstance(getattr(mdp, label), str):
            raise ValueError(
                f"{name}.{label}: expected a tuple of names such as ('x', 'v'), got "
                f"{getattr(mdp, label)!r}"
            )
    num_states = len(mdp.state_names)
    actions = np.asarray(actions_of(mdp))
    if actions.ndim != 2 or actions.shape[1] != len(mdp.action_names) or actions.shape[0] < 1:
        raise ValueError(
            f"{name}.actions: expected shape [A, {len(mdp.action_names)}], one row an action and "
            f"one column for each of action_names {mdp.action_names}, got {actions.shape}"
        )
    if not np.isfinite(actions).all():
        raise ValueError(f"{name}.actions: expected finite numbers, got {actions.tolist()}")
    real_numbers(mdp.bounds, f"{name}.bounds")
    if not number_or_nan(mdp.dt) > 0.0 or math.isinf(mdp.dt):
        raise ValueError(f"{name}.dt: expected a positive number of seconds, got {mdp.dt}")
    whole_number(mdp.num_steps, f"{name}.num_steps", 1)
    state = jnp.asarray(mdp.space.bounds.mean(axis=1), jnp.float32)
    goal = state
    if mdp.goal_names != mdp.state_names:
        goal = jnp.zeros(len(mdp.goal_names), jnp.float32)
    action = actions_of(mdp)[0]
    for label, method, arguments, shape, kind in (
        ("dynamics(state, action)", mdp.dynamics, (state, action), (num_states,), float),
        (
            "reward(state, action, next_state, goal)",
            mdp.reward,
            (state, action, state, goal),
            (),
            float,
        ),
        ("terminal_reward(state, goal)", mdp.terminal_reward, (state, goal), (), float),
        ("terminated(state, goal)", mdp.terminated, (state, goal), (), bool),
    ):
        _check_method(f"{name}.{label}", method, arguments, shape, kind)


def _check_method(
    label: str, method: Callable[..., Any], arguments: tuple[Array, ...], shape: tuple, kind: type
) -> None:
    """Call a method of an MDP, with and without tracing by JAX, and check the returned value."""
    try:
        jax.eval_shape(method, *arguments)
        value = jnp.asarray(method(*arguments))
    except BoundaryError:
        raise
    except Exception as error:
        reason = str(error).partition("\n")[0]
        raise ValueError(
            f"{label}: expected a function written with jax.numpy that takes these arguments, but "
            f"it raised {type(error).__name__}: {reason}"
        ) from error
    if value.shape != shape:
        raise ValueError(f"{label}: expected shape {shape}, got {value.shape}")
    numbers = np.asarray(value, float)
    forbidden = np.isneginf(numbers) & (kind is float and shape == ())  # a reward may be -inf
    if not (np.isfinite(numbers) | forbidden).all():
        hint = ": float32 holds at most 3.4e38" * bool(np.isinf(numbers).any())
        raise ValueError(
            f"{label}: expected finite numbers, got {np.asarray(value).tolist()} at the centre of "
            f"the bounds, state {np.asarray(arguments[0]).tolist()}{hint}"
        )


def _embed(state: Array, centre: np.ndarray, half: np.ndarray, is_angle: np.ndarray) -> Array:
    """Return angles as sine and cosine, other states scaled to [-1, 1] within the bounds."""
    straight = np.flatnonzero(~is_angle)
    angle = np.flatnonzero(is_angle)
    scaled = (state[straight] - centre[straight]) / half[straight]
    return jnp.concatenate([scaled, jnp.sin(state[angle]), jnp.cos(state[angle])])
