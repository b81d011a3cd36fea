"""Define MDPs with finitely many states, by tables of successors and rewards.

A state is a point of a lattice, 0 <= s_d < shape_d in each component d; states are numbered with
the first component fastest. Every solver takes a tabular MDP like any other MDP; the tabular solver
reads the tables directly.

Shapes: S states, A actions, n components of a state, g components of a goal, L states of a
demonstration.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from swerve.base.arguments import real_numbers
from swerve.base.space import StateSpace, Task, Transitions, lattice_number, nearest
from swerve.problem.mdp import MDP

NOWHERE = -1  # the successor of an action that a state does not offer


class TabularMDP(MDP):
    """A tabular MDP; subclasses provide the tables.

    Attributes:
      shape: number of values of each component of a state.
      successors: [S, A] the next state for each state and action, -1 where the action is not
        offered.
      rewards: [S, A] the reward of each action in each state, in units of reward.
    """

    if TYPE_CHECKING:  # a subclass may provide the values as fields or as properties
        shape: Any = eqx.field(init=False)
        successors: Any = eqx.field(init=False)
        rewards: Any = eqx.field(init=False)
    else:
        shape: eqx.AbstractVar[tuple[int, ...]]
        successors: eqx.AbstractVar[np.ndarray]
        rewards: eqx.AbstractVar[np.ndarray]

    dt = 1.0
    is_timed = False

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Half a step beyond the outer lattice points, at the edges of these points' cells."""
        return tuple((-0.5, size - 0.5) for size in self.shape)

    @property
    def space(self) -> StateSpace:
        """The state space, a lattice."""
        return StateSpace(tuple(self.state_names), (), np.asarray(self.bounds, float), True)

    @property
    def transitions(self) -> Transitions:
        """The successors of all states and actions, as data."""
        return Transitions(tuple(self.shape), self.successors, np.asarray(self.actions, float))

    @property
    def num_states(self) -> int:
        """S, the number of states."""
        return math.prod(self.shape)

    @property
    def states(self) -> np.ndarray:
        """[S, n] the lattice points, in the order of their numbers."""
        index = np.unravel_index(np.arange(self.num_states), self.shape, order="F")
        return np.stack(index, axis=-1).astype(float)

    def state_index(self, states: Any) -> Any:
        """Return the number [...] of states [..., n], NumPy or JAX; clipped to the lattice."""
        return lattice_number(states, self.shape)

    def action_index(self, actions: Any) -> Any:
        """Return the number [...] of the action nearest to each action [..., m]."""
        return nearest(actions, self.actions)

    def dynamics(self, state: Any, action: Any) -> Any:
        """Return the successor, or the state itself where the action is not offered."""
        index = self.state_index(state)
        following = jnp.asarray(self.successors)[index, self.action_index(action)]
        return jnp.asarray(self.states, state.dtype)[jnp.where(following < 0, index, following)]

    def reward(self, state: Any, action: Any, next_state: Any, goal: Any) -> Any:
        """Return the reward of the action, -inf where the action is not offered."""
        place = self.state_index(state), self.action_index(action)
        reward = jnp.asarray(self.rewards, state.dtype)[place]
        return jnp.where(jnp.asarray(self.successors)[place] < 0, -jnp.inf, reward)


class ArrayMDP(TabularMDP):
    """A tabular MDP made of arrays; see `tabular`.

    Attributes:
      terminal_rewards: [S] rewards paid in the state where an episode ends.
      absorbing: [S] True for states in which an episode ends before the horizon.
    """

    successors: np.ndarray = eqx.field()
    rewards: np.ndarray = eqx.field()
    terminal_rewards: np.ndarray = eqx.field()
    absorbing: np.ndarray = eqx.field()
    num_steps: int = eqx.field(static=True)

    state_names = ("state",)
    action_names = ("action",)
    goal_names = ()

    @property
    def shape(self) -> tuple[int, ...]:
        """(S,): the only component of a state is its number."""
        return (len(self.successors),)

    @property
    def actions(self) -> Any:
        """[A, 1] the numbers of the actions."""
        return jnp.arange(self.successors.shape[1], dtype=jnp.float32)[:, None]

    def terminal_reward(self, state: Any, goal: Any) -> Any:
        """Return the reward of ending in a state."""
        return jnp.asarray(self.terminal_rewards, state.dtype)[self.state_index(state)]

    def terminated(self, state: Any, goal: Any) -> Any:
        """Return whether the state is absorbing."""
        return jnp.asarray(self.absorbing)[self.state_index(state)]

    def goal_of(self, states: np.ndarray) -> np.ndarray:
        """Return a goal [0]: it has no components, since each start has only one task."""
        return np.zeros(0)

    def sample_task(self, key: Any) -> Any:
        """Sample a start."""
        return Task(jnp.round(MDP.sample_state(self, key)), jnp.zeros(0))


def tabular(
    transitions: Any,
    rewards: Any,
    *,
    num_steps: int,
    terminal_rewards: Any = None,
    absorbing: Sequence[int] = (),
) -> ArrayMDP:
    """Make an MDP of arrays.

    The only component of a state, `state`, is its number; so is that of an action, `action`.

    Args:
      transitions: [S, A] numbers of the successors, -1 where an action is not offered; or [A, S, S]
        probabilities of 0 and 1, an array or a list of A SciPy sparse matrices, with a row of zeros
        where an action is not offered.
      rewards: [S, A] or [S], in units of reward; -inf where an action is forbidden.
      num_steps: T, the horizon.
      terminal_rewards: [S] rewards paid in the state where an episode ends; 0 if None; -inf in
        states where no episode may end.
      absorbing: states in which an episode ends before the horizon.

    Returns:
      The MDP.

    Raises:
      ValueError: if a transition is stochastic or leads to no state, a reward is NaN or +inf, or
        shapes do not fit.
    """
    successors = _successors(transitions)
    num_states, num_actions = successors.shape
    rewards = real_numbers(rewards, "rewards")
    if rewards.shape == (num_states,):
        rewards = np.repeat(rewards[:, None], num_actions, axis=1)
    if terminal_rewards is None:
        terminal_rewards = np.zeros(num_states)
    ends = np.zeros(num_states, bool)
    places = np.asarray(absorbing, int).reshape(-1)
    if places.size and not (places.min() >= 0 and places.max() < num_states):
        raise ValueError(f"absorbing: expected states from 0 to {num_states - 1}, got {absorbing}")
    ends[places] = True
    return ArrayMDP(
        successors=successors,
        rewards=_checked_rewards("rewards", rewards, (num_states, num_actions)),
        terminal_rewards=_checked_rewards("terminal_rewards", terminal_rewards, (num_states,)),
        absorbing=ends,
        num_steps=num_steps,
    )


def _checked_rewards(name: str, rewards: Any, shape: tuple[int, ...]) -> np.ndarray:
    rewards = real_numbers(rewards, name)
    if rewards.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {rewards.shape}")
    wrong = np.argwhere(np.isnan(rewards) | (rewards == np.inf))
    if len(wrong):
        place = ", ".join(map(str, wrong[0]))
        raise ValueError(
            f"{name}[{place}]: expected a number, or -inf where forbidden, got "
            f"{rewards[tuple(wrong[0])]}"
        )
    return rewards


def _successors(transitions: Any) -> np.ndarray:
    """Return successors [S, A] from transitions in any of the forms that `tabular` takes."""
    if not np.size(transitions) or not len(transitions):
        raise ValueError(
            "transitions: expected at least one state and one action, got shape "
            f"{np.shape(transitions)}"
        )
    is_list = isinstance(transitions, Sequence) and hasattr(transitions[0], "tocsr")
    if not is_list and np.ndim(transitions) == 2:
        successors = np.asarray(transitions)
        outside = np.argwhere((successors < NOWHERE) | (successors >= len(successors)))
        if not np.issubdtype(successors.dtype, np.integer) or len(outside):
            place = tuple(outside[0]) if len(outside) else (0, 0)
            raise ValueError(
                f"transitions[{place[0]}, {place[1]}]: expected the number of a state, from 0 to "
                f"{len(successors) - 1}, or -1 where the action is not offered, got "
                f"{successors[place]}"
            )
        return successors.astype(np.int32)
    if not is_list and np.ndim(transitions) != 3:
        raise ValueError(
            "transitions: expected [S, A] successors, [A, S, S] probabilities or a list of A "
            f"sparse matrices, got shape {np.shape(transitions)}"
        )
    return np.stack([_of_matrix(matrix, a) for a, matrix in enumerate(transitions)], axis=1)


def _of_matrix(matrix: Any, action: int) -> np.ndarray:
    """Return successors [S] from the probabilities [S, S] of one action, dense or sparse."""
    import scipy.sparse

    rows: Any = scipy.sparse.csr_matrix(matrix)
    rows.eliminate_zeros()
    num_states = rows.shape[0]
    if rows.shape != (num_states, num_states):
        raise ValueError(
            f"transitions[{action}]: expected a square matrix, one column for each state, got "
            f"{rows.shape}: a row would point outside"
        )
    number = np.diff(rows.indptr)
    certain = np.zeros(num_states, bool)
    certain[number == 1] = rows.data[rows.indptr[:-1][number == 1]] == 1.0
    for state in np.flatnonzero(~certain & (number > 0))[:1]:
        data = rows.data[rows.indptr[state] : rows.indptr[state + 1]]
        raise ValueError(
            f"transitions[{action}, {state}]: expected a single successor of probability 1, got "
            f"probabilities {data[:5].tolist()}: Swerve needs deterministic transitions (with "
            "chance in the dynamics, Theorem 1 does not hold)"
        )
    successors = np.full(num_states, NOWHERE, np.int32)
    successors[number == 1] = rows.indices[rows.indptr[:-1][number == 1]]
    return successors
