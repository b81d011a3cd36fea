"""Random tabular MDPs, and the sum over all of their paths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from hypothesis import strategies as st

from swerve import ActionBox, Box, Constraint, Problem, Task, Union, tabular
from swerve.evidence.exact import ExactAnswer
from swerve.solvers.exact.tabular import TableNominal, Tabular
from swerve.systems.tabular import NOWHERE


@dataclass(frozen=True)
class Model:
    """A tabular MDP, a start, and settings of a problem.

    The hypotheses are its states, its actions, and a union of the last of both.

    Attributes:
      known: those of the hypotheses that are known.
    """

    successors: np.ndarray
    rewards: np.ndarray
    terminal: np.ndarray
    num_steps: int
    absorbing: tuple[int, ...] = ()
    known: tuple[int, ...] = ()
    start: int = 0
    beta: float = 1.0
    measure: str = "counting"
    between_states: bool = False
    order: tuple[int, ...] = ()

    @property
    def num_hypotheses(self) -> int:
        return sum(self.successors.shape) + 1

    @property
    def constraints(self) -> list[Constraint]:
        states, actions = map(range, self.successors.shape)
        boxes = [Box(state=(s - 0.5, s + 0.5)) for s in states]
        moves = [ActionBox(action=(a - 0.5, a + 0.5)) for a in actions]
        return [*boxes, *moves, Union("last", [boxes[-1], moves[-1]])]

    @property
    def problem(self) -> Problem:
        mdp = tabular(
            self.successors,
            self.rewards,
            num_steps=self.num_steps,
            terminal_rewards=self.terminal,
            absorbing=self.absorbing,
        )
        constraints = self.constraints
        return Problem(
            mdp,
            [constraints[k] for k in self.order or range(len(constraints))],
            beta=self.beta,
            measure=self.measure,
            known=[constraints[k] for k in self.known],
            between_states=self.between_states,
        )

    @property
    def task(self) -> Task:
        return Task(np.array([float(self.start)]), np.zeros(0))

    @cached_property
    def nominal(self) -> TableNominal:
        return Tabular().learn(self.problem)

    @cached_property
    def answer(self) -> ExactAnswer:
        return self.nominal.answer(self.task, np.random.default_rng(0))

    def log_partition(self, *avoiding: Sequence[int]) -> np.ndarray:
        return self.nominal.log_partition(self.task, avoiding)


@dataclass(frozen=True)
class Path:
    """A trajectory, and the hypotheses that it enters."""

    states: tuple[int, ...]
    total_reward: float
    entered: frozenset[int]


def paths_of(model: Model) -> list[Path]:
    """Return all trajectories that are allowed, one after another."""
    num_states, num_actions = model.successors.shape
    found: list[Path] = []

    def entered_by(state: int, action: int, following: int) -> set[int]:
        visited = {state, following}
        if model.between_states:
            visited = set(range(min(visited), max(visited) + 1))
        last = (num_states - 1 in visited) or action == num_actions - 1
        return visited | {num_states + action} | ({num_states + num_actions} if last else set())

    def go(states: tuple[int, ...], reward: float, entered: frozenset[int]) -> None:
        length, state = len(states) - 1, states[-1]
        if length == model.num_steps or (length > 0 and state in model.absorbing):
            found.append(Path(states, reward + model.terminal[state], entered))
            return
        for action, following in enumerate(model.successors[state].tolist()):
            more = entered_by(state, action, following)
            if following != NOWHERE and not more & set(model.known):
                go((*states, following), reward + model.rewards[state, action], entered | more)

    go((model.start,), 0.0, frozenset())
    return [path for path in found if path.total_reward > -math.inf]


def log_mass(model: Model, paths: Sequence[Path], avoiding: Sequence[int] = ()) -> float:
    """Return log Z_C by summing."""
    offset = math.log(model.successors.shape[1]) if model.measure == "uniform" else 0.0
    weights = [
        model.beta * path.total_reward - offset * (len(path.states) - 1)
        for path in paths
        if not path.entered & set(avoiding)
    ]
    return float(np.logaddexp.reduce(weights)) if weights else -math.inf


@st.composite
def models(draw: Any, *, ends_early: bool = True) -> Model:
    """Draw a small MDP; its tables come from a seed, lest most of them be all alike."""
    num_states, num_actions = draw(st.sampled_from([4, 3, 2, 1])), draw(st.sampled_from([3, 2, 1]))
    shape = num_states, num_actions
    generator = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    start = int(generator.integers(num_states))
    others = [state for state in range(num_states) if state != start]
    moves = range(num_states, num_states + num_actions)
    successors = generator.integers(num_states, size=shape)
    rewards = -3.0 * generator.random(shape)
    terminal = generator.integers(-16, 1, num_states) / 8.0  # exact in float32
    return Model(
        successors=np.where(generator.random(shape) < 0.15, NOWHERE, successors),
        rewards=np.where(generator.random(shape) < 0.1, -1e3, rewards),
        terminal=np.where(generator.random(num_states) < 0.2, -math.inf, terminal),
        num_steps=draw(st.sampled_from([4, 3, 2, 1])),
        absorbing=tuple(generator.permutation(others)[: ends_early * generator.integers(3)]),
        known=tuple(generator.permutation([*others, *moves])[: generator.integers(2)]),
        start=start,
        beta=draw(st.sampled_from([0.3, 1.0, 4.0, 1e-9])),
        measure=draw(st.sampled_from(["counting", "uniform"])),
        between_states=draw(st.booleans()),
    )
