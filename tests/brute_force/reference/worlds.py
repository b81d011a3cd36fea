"""Small random worlds: what actions do, what they earn, and where episodes end.

    s' = s + dt (D s + B a + k sin(W s + p)),
    r(s, a, s', g) = -c |a|^2 - sum_i q_i e_i(s', g) + w sin(s'_0),
    r_T(s, g) = -sum_i f_i e_i(s, g),

with e_i the squared difference to the goal, 1 - cos for angles. An episode may end where a sum of
states exceeds a limit; then a penalty is paid beside r_T. The sums do not change by full turns of
an angle. A table has numbers as states instead.

Shapes: N states, n dimensions of one, A actions, m components of one, g components of a goal,
S states of a table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from brute_force.reference.geometry import NEAR, AmbiguousError, Axes


class Moves(NamedTuple):
    """What one action does in N states.

    Attributes:
      states: [N, n] the next states.
      rewards: [N] r(s, a, s'); -inf where the action is not offered.
      ended: [N] whether the episode ends there before the horizon.
      terminal: [N] r_T of the next states.
    """

    states: np.ndarray
    rewards: np.ndarray
    ended: np.ndarray
    terminal: np.ndarray


class World(Protocol):
    """What the enumeration needs."""

    @property
    def axes(self) -> Axes: ...

    @property
    def action_names(self) -> tuple[str, ...]: ...

    @property
    def actions(self) -> np.ndarray: ...

    @property
    def num_steps(self) -> int: ...

    @property
    def dt(self) -> float: ...

    def moves(self, states: np.ndarray, action: int, goal: np.ndarray) -> Moves: ...


@dataclass(frozen=True, eq=False)
class SmoothWorld:
    """A world of continuous states; see the formulas above.

    Attributes:
      goal_columns: the states that the goal is about.
      goals_are_states: whether a goal is a whole state.
      limit: an episode ends where `ending` @ s exceeds this; infinite for none.
    """

    axes: Axes
    action_names: tuple[str, ...]
    actions: np.ndarray
    num_steps: int
    dt: float
    drift: np.ndarray
    push: np.ndarray
    bend: np.ndarray
    waves: np.ndarray
    phase: np.ndarray
    effort: float
    running: np.ndarray
    final: np.ndarray
    ripple: float
    ending: np.ndarray
    limit: float
    penalty: float
    goals_are_states: bool

    @property
    def mdp_steps(self) -> int:
        """The horizon of the library's MDP."""
        return self.num_steps

    @property
    def goal_columns(self) -> tuple[int, ...]:
        """The states that a goal gives: all, or the first alone."""
        return tuple(range(len(self.axes.names))) if self.goals_are_states else (0,)

    def step(self, states: np.ndarray, action: int) -> np.ndarray:
        """Return the next states [N, n]."""
        change = states @ self.drift.T + self.push @ self.actions[action]
        change = change + self.bend * np.sin(states @ self.waves.T + self.phase)
        return states + self.dt * change

    def off(self, states: np.ndarray, goal: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return sum_i w_i e_i [N] of states [N, n]."""
        total = np.zeros(len(states))
        for place, column in enumerate(self.goal_columns):
            away = states[:, column] - goal[place]
            is_angle = self.axes.names[column] in self.axes.angles
            total += weights[column] * (1.0 - np.cos(away) if is_angle else away**2)
        return total

    def moves(self, states: np.ndarray, action: int, goal: np.ndarray) -> Moves:
        following = self.step(states, action)
        ended = np.zeros(len(states), bool)
        if np.isfinite(self.limit):
            beyond = following @ self.ending - self.limit
            if (np.abs(beyond) < NEAR).any():
                raise AmbiguousError("a state lies on the limit")
            ended = beyond > 0.0
        effort = self.effort * (self.actions[action] ** 2).sum()
        reward = -effort - self.off(following, goal, self.running)
        reward = reward + self.ripple * np.sin(following[:, 0])
        terminal = -self.off(following, goal, self.final) - self.penalty * ended
        return Moves(following, reward, ended, terminal)


NUMBERED = Axes(("state",))


@dataclass(frozen=True, eq=False)
class TableWorld:
    """A world of S numbered states; -1 is the successor of an action that is not offered."""

    successors: np.ndarray
    rewards: np.ndarray
    terminal: np.ndarray
    absorbing: np.ndarray
    num_steps: int
    axes: Axes = NUMBERED
    action_names: tuple[str, ...] = ("action",)
    dt: float = 1.0

    @property
    def actions(self) -> np.ndarray:
        """[A, 1] the numbers of the actions."""
        return np.arange(self.successors.shape[1], dtype=float)[:, None]

    def moves(self, states: np.ndarray, action: int, goal: np.ndarray) -> Moves:
        number = np.rint(states[:, 0]).astype(int)
        following = self.successors[number, action]
        offered = following >= 0
        following = np.where(offered, following, number)
        reward = np.where(offered, self.rewards[number, action], -np.inf)
        ended = self.absorbing[following]
        return Moves(following[:, None].astype(float), reward, ended, self.terminal[following])


def random_smooth_world(generator: np.random.Generator, num_steps: int, num: int) -> SmoothWorld:
    """Make a world of 1 to 3 states and `num` actions, with and without an angle."""
    n = int(generator.integers(1, 4))
    names = ("x", "v", "z")[:n]
    angle = int(generator.integers(n)) if generator.random() < 0.5 else None
    if angle is not None:
        names = tuple("theta" if k == angle else name for k, name in enumerate(names))
    m = int(generator.integers(1, 3))
    actions = np.round(generator.uniform(-1.0, 1.0, (num, m)) * 32) / 32
    actions[0, 0], actions[1, 0] = -1.0, 1.0
    drift = generator.uniform(-0.4, 0.4, (n, n)) * (generator.random((n, n)) < 0.6)
    waves = generator.uniform(-1.5, 1.5, (n, n))
    if angle is not None:
        drift[:, angle] = 0.0
        waves[:, angle] = generator.integers(-1, 2, n)
    bend = generator.uniform(-0.8, 0.8, n) * (generator.random() < 0.6)
    ends = generator.random() < 0.4 and angle != 0
    return SmoothWorld(
        axes=Axes(names, () if angle is None else ("theta",)),
        action_names=("force", "turn")[:m],
        actions=actions,
        num_steps=num_steps,
        dt=0.5,
        drift=drift,
        push=generator.uniform(0.5, 1.6, (n, m)) * generator.choice([-1.0, 1.0], (n, m)),
        bend=bend,
        waves=waves,
        phase=generator.uniform(-1.0, 1.0, n),
        effort=float(generator.uniform(0.0, 0.5)),
        running=generator.uniform(0.0, 0.6, n),
        final=generator.uniform(0.0, 1.5, n),
        ripple=float(generator.uniform(-0.5, 0.5)),
        ending=np.eye(n)[0],
        limit=float(generator.uniform(0.8, 1.6)) if ends else np.inf,
        penalty=float(generator.uniform(-1.0, 3.0)),
        goals_are_states=bool(generator.random() < 0.7),
    )


def random_table_world(generator: np.random.Generator, num_steps: int, num: int) -> TableWorld:
    """Make a table of 4 to 9 states and `num` actions; some actions are not offered."""
    size = int(generator.integers(4, 10))
    successors = generator.integers(0, size, (size, num))
    successors[:, 1:][generator.random((size, num - 1)) < 0.2] = -1
    absorbing = np.zeros(size, bool)
    absorbing[-1] = generator.random() < 0.5
    return TableWorld(
        successors=successors,
        rewards=generator.uniform(-1.0, 0.5, (size, num)),
        terminal=generator.uniform(-2.0, 1.0, size),
        absorbing=absorbing,
        num_steps=num_steps,
    )
