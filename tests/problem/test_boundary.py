"""Numbers of any kind that a user's code returns: cast once, and the same for every caller."""

from __future__ import annotations

import warnings
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.small_mdps import ANGLES, Bare

import swerve
from swerve import MDP, Problem, Task
from swerve.problem.tasks import checked_tasks

STATE = jnp.array([1.0, 0.5], jnp.float32)
ACTION = jnp.array([0.5, 0.0], jnp.float32)
KINDS = [
    lambda x: jnp.asarray(x, jnp.float16),
    lambda x: jnp.asarray(x, jnp.bfloat16),
    lambda x: jnp.asarray(x, jnp.int32),
    lambda x: jnp.asarray(x, jnp.int8),
    lambda x: jnp.asarray(x, bool),
    lambda x: np.asarray(x, np.float64),
    lambda x: np.asarray(x, np.int64),
    lambda x: np.asarray(x).tolist(),
]


def made(**methods: Any) -> MDP:
    """Return an MDP of two states with some methods replaced."""
    return type("Given", (Bare,), methods)()


@pytest.mark.parametrize("kind", KINDS)
class TestKindsOfNumbers:
    """The numbers are 0 and 1, which all kinds hold."""

    def test_states_and_rewards_are_float32(self, kind: Any) -> None:
        mdp = made(
            dynamics=lambda self, state, action: kind([0, 1]),
            reward=lambda self, state, action, next_state, goal: kind(1),
            terminal_reward=lambda self, state, goal: kind(1),
            features=lambda self, state, step, goal: kind([1, 0, 1]),
            sample_state=lambda self, key: kind([1, 0]),
        )
        for value, expected in (
            (mdp.dynamics(STATE, ACTION), [0.0, 1.0]),
            (mdp.reward(STATE, ACTION, STATE, STATE), 1.0),
            (mdp.terminal_reward(STATE, STATE), 1.0),
            (mdp.features(STATE, jnp.int32(0), STATE), [1.0, 0.0, 1.0]),
            (mdp.sample_state(jax.random.key(0)), [1.0, 0.0]),
        ):
            assert value.dtype == jnp.float32
            assert not value.weak_type
            np.testing.assert_array_equal(value, expected)

    def test_endings_are_booleans(self, kind: Any) -> None:
        mdp = made(terminated=lambda self, state, goal: kind(1))
        assert mdp.terminated(STATE, STATE).dtype == bool
        assert mdp.terminated(STATE, STATE)
        assert Problem(mdp, ANGLES).mdp is mdp

    def test_tasks_may_be_pairs(self, kind: Any) -> None:
        for pair in (tuple, list, lambda parts: Task(*parts)):
            mdp = made(sample_task=lambda self, key, pair=pair: pair((kind([0, 1]), kind([1, 1]))))
            start, goal = mdp.sample_task(jax.random.key(0))
            assert (start.dtype, goal.dtype) == (jnp.float32, jnp.float32)

    def test_actions_are_float32_or_whole(self, kind: Any) -> None:
        mdp = made(actions=kind([[0, 1], [1, 0]]))
        problem = Problem(mdp, ANGLES)
        assert problem.mdp.num_actions == 2
        nominal = swerve.learn(problem, "enumeration")
        evidence = swerve.sample(nominal, Task([1.0, 0.5], [1.0, 0.5]))
        assert np.isfinite(evidence.log_partition).all()


class Mixin:
    def reward(self, state: Any, action: Any, next_state: Any, goal: Any) -> Any:
        return 2


class OfMixin(Mixin, Bare):
    pass


class Jitted(Bare):
    @eqx.filter_jit
    def dynamics(self, state: Any, action: Any) -> Any:
        return state.astype(jnp.float16)


class OfParent(Jitted):
    def dynamics(self, state: Any, action: Any) -> Any:
        return super().dynamics(state, action).astype(jnp.int32)


class Static(Bare):
    @staticmethod
    def terminal_reward(state: Any, goal: Any) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        return 3


def test_methods_of_any_origin_are_cast() -> None:
    assert OfMixin().reward(STATE, ACTION, STATE, STATE).dtype == jnp.float32
    for mdp in (Jitted(), OfParent()):
        assert mdp.dynamics(STATE, ACTION).dtype == jnp.float32
    assert Static().terminal_reward(STATE, STATE) == 3.0
    assert type(Bare()).goal_of is MDP.goal_of


@pytest.mark.parametrize(
    ("methods", "message"),
    [
        (
            {"reward": lambda self, state, action, next_state, goal: state[0] * (1.0 + 2.0j)},
            r"Given\.reward: expected real numbers, got complex64: return the part .* value\.real",
        ),
        (
            {"dynamics": lambda self, state, action: state * 1.0j},
            r"Given\.dynamics: expected real numbers, got complex64",
        ),
        (
            {"terminal_reward": lambda self, state, goal: 1.0j},
            r"Given\.terminal_reward: expected real numbers, got complex64",
        ),
        ({"actions": np.array([[1.0j, 0.0]])}, r"Given\.actions: expected real numbers, got comp"),
        ({"actions": [["left", "right"]]}, r"Given\.actions: expected numbers, got \[\['left'"),
        ({"dynamics": lambda self, state, action: None}, r"Given\.dynamics: expected numbers, got"),
        ({"reward": lambda self, *_: "much"}, r"Given\.reward: expected numbers, got 'much'"),
        (
            {"reward": lambda self, *_: jax.random.key(0)},
            r"Given\.reward: expected numbers, got key",
        ),
    ],
)
def test_what_is_no_real_number_is_refused_by_name(methods: dict, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        Problem(made(**methods), ANGLES)


def branching(self: MDP, state: Any, action: Any, next_state: Any, goal: Any) -> Any:
    return -1.0 if state[0] > 0 else 0.0


@pytest.mark.parametrize(
    ("reward", "advice"),
    [
        (branching, r"use jnp\.where, not if, and &, \| and ~, not and, or and not"),
        (lambda self, state, *_: 1.0 if state > 0 else 0.0, r"use jnp\.where, not if"),
        (lambda self, state, *_: np.sin(state[0]), r"use jax\.numpy, not NumPy"),
        (lambda self, state, *_: float(state[0]), r"use jax\.numpy, not float\(\), int"),
        (
            lambda self, state, *_: [1.0, 2.0][state[0].astype(int)],
            r"use an array of jax\.numpy, not an index into a list",
        ),
        (
            lambda self, state, *_: state[state > 0].sum(),
            r"use jnp\.where, not an index of booleans",
        ),
    ],
)
def test_a_method_that_cannot_be_traced_is_told_by_its_line(reward: Any, advice: str) -> None:
    line = reward.__code__.co_firstlineno + (reward is branching)
    message = rf"^Given\.reward: expected a function that JAX can trace.*py, line {line}: {advice}"
    with pytest.raises(ValueError, match=message):
        Problem(made(reward=reward), ANGLES)


@pytest.mark.parametrize("value", [1e39, np.float64(1e39), np.full(2, 1e300)])
def test_numbers_beyond_float32_are_told_without_a_warning_of_libraries(value: Any) -> None:
    rewards = made(reward=lambda self, state, *_: jnp.where(state[0] > 0, np.sum(value), 0.0))
    for mdp in (rewards, made(dynamics=lambda self, state, action: np.zeros(2) - value)):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pytest.raises(ValueError, match=r"finite numbers, .*inf.*holds at most 3.4e38"):
                Problem(mdp, ANGLES)


@pytest.mark.parametrize("most", [1e300, np.finfo(float).max])
def test_guards_beyond_float32_are_infinite(most: float) -> None:
    rewards = made(reward=lambda self, state, *_: jnp.maximum(-state[0], -most))
    far = made(reward=lambda self, state, *_: jnp.where(state[0] > 50.0, -most, -state[0]))
    moves = made(dynamics=lambda self, state, action: jnp.clip(0.9 * state, -most, most))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for mdp in (rewards, far, moves):
            Problem(mdp, ANGLES)


def test_a_reward_in_brackets_is_refused_by_its_shape() -> None:
    mdp = made(reward=lambda self, state, action, next_state, goal: action[:1])
    with pytest.raises(ValueError, match=r"reward\(.*\): expected shape \(\), got \(1,\)"):
        Problem(mdp, ANGLES)


@pytest.mark.parametrize(
    ("method", "given"),
    [("sample_task", lambda self, key: jnp.zeros(3)), ("sample_task", lambda self, key: None)],
)
def test_a_task_needs_a_start_and_a_goal(method: str, given: Any) -> None:
    with pytest.raises(ValueError, match=r"Given\.sample_task: expected swerve\.Task\(start, goal"):
        getattr(made(**{method: given}), method)(jax.random.key(0))


class Lattice(MDP):
    """Whole numbers throughout: states, actions and rewards."""

    state_names = ("place",)
    action_names = ("move",)
    actions = np.array([[-1], [0], [1]])
    bounds = ((-4, 4),)
    dt = 1
    num_steps = 3

    def dynamics(self, state: Any, action: Any) -> Any:
        return jnp.round(state).astype(jnp.int32) + action

    def reward(self, state: Any, action: Any, next_state: Any, goal: Any) -> Any:
        return -jnp.abs(action[0])

    def terminated(self, state: Any, goal: Any) -> Any:
        return jnp.where(jnp.abs(state[0]) > 2, 1.0, 0.0)


@pytest.mark.parametrize("solver", ["enumeration", "grid?num_points=9", "discrete?num_cells=9"])
def test_whole_numbers_throughout_give_the_sum_over_all_sequences(solver: str) -> None:
    """27 sequences of moves, fewer where |place| > 2 ends the episode: at step 3 alone."""
    problem = Problem(Lattice(), [swerve.Box(place=(0.5, 1.5))], measure="counting")
    evidence = swerve.sample(swerve.learn(problem, solver), Task([0], [0]), 400)
    tolerance = 1e-6 if evidence.is_exact else 5.0 * evidence.log_partition_error[0] + 1e-3
    assert evidence.log_partition[0] == pytest.approx(3 * np.log(1 + 2 / np.e), abs=tolerance)


def any_kind(value: Any) -> Any:
    """A value whose type is not checked before the test runs."""
    return value


COMPLEX = np.array([0.5j, 0.0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: made(bounds=((0.0, 1.0j), (0.0, 1.0))), r"Given\.bounds: expected real numbers"),
        (lambda: made(dt=1.0j), r"Given\.dt: expected a positive number of seconds, got 1j"),
        (lambda: made(dt="fast"), r"Given\.dt: expected a positive number of seconds, got fast"),
        (lambda: made(bounds=(("a", "b"), (0.0, 1.0))), r"Given\.bounds: expected numbers, got"),
    ],
)
def test_attributes_are_real_numbers(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        Problem(make(), ANGLES)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: checked_tasks(Problem(Bare(), ANGLES), Task(COMPLEX, COMPLEX)),
            "tasks: start: ex",
        ),
        (
            lambda: Task.stack([Task([0.5j, 0.0], COMPLEX)]),
            "start of a task: expected real numbers",
        ),
        (lambda: Task.stack([Task([0.5, 0.0], COMPLEX)]), "goal of a task: expected real numbers"),
        (lambda: Task.stack([Task(["a", 0.0], [0.0])]), "start of a task: expected numbers, got"),
        (
            lambda: swerve.Demonstration("d", np.stack([COMPLEX, COMPLEX]), Task([0, 0], [0, 0])),
            "d: states: expected real numbers",
        ),
        (lambda: swerve.tabular([[0, 0]], COMPLEX[:1], num_steps=1), "rewards: expected real num"),
        (lambda: swerve.Box(x=any_kind((np.complex128(0.5j), 1.0))), "Box: .*, got "),
        (
            lambda: Problem(Bare(), ANGLES, beta=any_kind(1.0 + 1.0j)),
            "beta: expected a finite",
        ),
    ],
)
def test_complex_numbers_are_refused_and_never_cut(call: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
