"""Ways to the same number: solvers held against one another, and identities that join two."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from support.reference import (
    CART_TASK,
    PENDULUM_TASK,
    Cart,
    enumerate_exactly,
    short_cart,
    short_pendulum,
)
from support.routes import (
    ABOVE,
    BELOW,
    HEIGHT,
    MIDDLE,
    NUM_STEPS,
    TASK,
    WALL,
    LatticeRoutes,
    Planted,
    Routes,
    routes,
    share_above,
)

from swerve import (
    PPO,
    ActionBox,
    Box,
    Demonstration,
    Evidence,
    Grid,
    Gridworld,
    Inference,
    Pendulum,
    Problem,
    Tabular,
    Task,
    Union,
    demonstrate,
    greedy,
    infer,
    learn,
    sample,
)
from swerve.constraints.base import violates
from swerve.evidence import estimators
from swerve.evidence.samples import METHODS, NUM_KEPT
from swerve.hypotheses.base import unpack
from swerve.solvers.exact.enumeration import Enumeration, EnumerationNominal
from swerve.solvers.exact.tabular import TableNominal
from swerve.solvers.learn import Solver
from swerve.systems.gridworld import MOVES, cell_box, move_box

STANDARD_ERRORS = 4.5
NUM = 20_000
SMALL_PPO = PPO(
    num_steps=500_000,
    num_lanes=128,
    segment=16,
    num_minibatches=4,
    width=32,
    learning_rate=1e-2,
)
settings = pytest.mark.parametrize(
    ("measure", "between_states"),
    [("uniform", True), ("uniform", False), ("counting", True), ("counting", False)],
)


@cache
def enumerated(problem: Problem) -> EnumerationNominal:
    nominal = learn(problem, Enumeration())
    assert isinstance(nominal, EnumerationNominal)
    return nominal


@cache
def tabulated(problem: Problem) -> TableNominal:
    nominal = learn(problem, Tabular())
    assert isinstance(nominal, TableNominal)
    return nominal


def is_open(probability: np.ndarray) -> np.ndarray:
    """Return where an estimate has room to be wrong in."""
    return (probability > 0.1) & (probability < 0.9)


# -- exact against exact -------------------------------------------------------------------------

WORLD = Gridworld(
    4, 3, 5, walls=((1, 1),), cell_features=(("ice", ((2, 1), (3, 1))), ("mud", ((0, 1), (2, 2))))
)
WORLD_TASK = Task(np.array([0.0, 0.0]), np.array([3.0, 2.0]))
KNOWN = [Union("known", [cell_box((2, 0)), move_box("up-left")])]


def world(**settings: Any) -> Problem:
    settings = {"beta": 0.2} | settings
    return Problem(WORLD, WORLD.hypotheses(), **settings)


@settings
@pytest.mark.parametrize("known", [(), KNOWN], ids=["free", "known"])
def test_tables_agree_with_enumeration(known: Sequence, measure: str, between_states: bool) -> None:
    problem = world(known=known, measure=measure, between_states=between_states)
    by_table, by_sequence = (sample(f(problem), WORLD_TASK) for f in (tabulated, enumerated))
    assert by_table.log_partition[0] == pytest.approx(by_sequence.log_partition[0], abs=1e-12)
    np.testing.assert_allclose(
        by_table.summary.avoid_probability, by_sequence.summary.avoid_probability, rtol=1e-12
    )
    probability = by_table.violation_probability[0]
    moves = is_open(probability[-len(MOVES) :])
    assert np.count_nonzero(is_open(probability)) >= 8
    assert np.count_nonzero(moves) >= 2
    sets = [[0, 1], [1, 8], [5, 15], [3, 4, 17], [0, 16, 20]]
    np.testing.assert_allclose(
        tabulated(problem).log_partition(WORLD_TASK, sets),
        enumerated(problem).log_partition(WORLD_TASK, sets),
        rtol=1e-12,
    )


@pytest.mark.parametrize("between_states", [True, False])
def test_tables_agree_with_the_reference(between_states: bool) -> None:
    """With nothing of the library between the MDP and the sum but the judging of whole paths."""
    problem = world(known=KNOWN, between_states=between_states)
    exact = enumerate_exactly(problem, *WORLD_TASK)
    found = sample(tabulated(problem), WORLD_TASK)
    assert found.log_partition[0] == pytest.approx(exact.log_partition, abs=1e-10)
    np.testing.assert_allclose(
        found.violation_probability[0], exact.violation_probability, atol=1e-10
    )


@settings
@pytest.mark.parametrize("toll", [0.0, 1.5])
def test_tables_agree_with_enumeration_of_the_same_routes(
    toll: float, measure: str, between_states: bool
) -> None:
    """The dynamics of one are a formula, of the other a table, and no episode ends early."""
    changes = {"beta": 0.8, "measure": measure, "between_states": between_states}
    by_sequence = sample(enumerated(routes(Routes(toll=toll), **changes)), TASK)
    by_table = sample(tabulated(routes(LatticeRoutes(toll=toll), **changes)), TASK)
    assert by_table.log_partition[0] == pytest.approx(by_sequence.log_partition[0], abs=1e-12)
    np.testing.assert_allclose(
        by_table.summary.avoid_probability, by_sequence.summary.avoid_probability, rtol=1e-12
    )
    assert np.count_nonzero(is_open(by_table.violation_probability)) >= 10


# -- sampled against exact -----------------------------------------------------------------------


class Case(NamedTuple):
    """A problem to be sampled, and tasks two of which share a goal.

    Attributes:
      least_ess: share of all trajectories that weights are worth, of each solver.
    """

    problem: Problem
    tasks: Task
    least_ess: dict[str, float]


PENDULUM_CELLS = [
    Box(theta=(a, a + 0.5), omega=(b, b + 1.0))
    for a, b in itertools.product((2.5, 3.0, 3.5, 4.0), (-1.0, 0.0, 1.0))
]
PENDULUM = Case(
    Problem(
        Pendulum(max_torque=3.0, num_torques=3, dt=0.3, num_steps=8),
        [
            *PENDULUM_CELLS,
            Box(theta=(-0.5, 0.3)),
            Union("swings", [PENDULUM_CELLS[0], PENDULUM_CELLS[-1]]),
            Union("slow or left", [Box(omega=(-1.0, -0.6)), ActionBox(torque=(-9.0, -1.0))]),
        ],
        beta=0.05,
    ),
    Task(
        np.array([[2.5, 0.5], [3.2, -0.5], [2.5, 0.5]]),
        np.array([[4.0, -0.5], [4.0, -0.5], [3.6, -0.2]]),
    ),
    {"grid": 0.95, "ppo": 0.4},
)
CART = Case(
    Problem(
        Cart(),
        [
            *(short_cart().hypotheses.constraint(k) for k in (4, 5, 9, 13, 14, 17, 21, 22, 23)),
            Box(x=(1.5, 9.0)),
            ActionBox(force=(0.5, 2.0)),
            ActionBox(force=(-0.5, 0.5)),
            Union("back or fast", [ActionBox(force=(-2.0, -0.5)), Box(v=(0.6, 9.0))]),
        ],
        beta=0.3,
        known=[Union("known", [Box(x=(0.2, 0.5), v=(-2.0, -0.6)), Box(v=(1.2, 9.0))])],
    ),
    Task(
        np.array([[0.6, 0.3], [0.9, 0.6], [0.3, 0.3]]),
        np.array([[-0.5, 0.0], [-0.5, 0.0], [-0.2, 0.2]]),
    ),
    {"grid": 0.5, "ppo": 0.3},
)
CASES = {"pendulum": PENDULUM, "cart": CART}
GRID = Grid(num_points=121)


@cache
def exact(name: str) -> Evidence:
    return sample(enumerated(CASES[name].problem), CASES[name].tasks)


@cache
def pairs(name: str) -> list[dict[tuple[int, ...], float]]:
    """Return log Z_C of each task for all pairs C of hypotheses that are neither rare nor sure."""
    problem, tasks, _ = CASES[name]
    found = []
    for probability, *task in zip(exact(name).violation_probability, *tasks, strict=True):
        sets = list(itertools.combinations(np.flatnonzero(is_open(probability)).tolist(), 2))
        values = enumerated(problem).log_partition(Task(*task), sets)
        found.append(dict(zip(sets, values.tolist(), strict=True)))
    return found


@cache
def sampled(name: str, solver: Solver) -> Evidence:
    """Return evidence by importance weights, drawn one by one."""
    nominal = learn(CASES[name].problem, solver)
    return sample(nominal, CASES[name].tasks, NUM, method="importance", seed=1)


def assert_within_errors(evidence: Evidence, truth: Evidence, least_ess: float) -> None:
    """Estimates of each task, importance-weighted, are as near as they claim to be."""
    for k, ess in enumerate(evidence.effective_sample_size):
        assert ess >= least_ess * NUM
        error = np.sqrt(evidence.summary.avoid_variance[k]) + 1.0 / ess
        difference = evidence.violation_probability[k] - truth.violation_probability[k]
        assert np.abs(difference / error).max() < STANDARD_ERRORS
        assert np.count_nonzero(is_open(truth.violation_probability[k])) >= 5
        spread = math.sqrt(1.0 / ess - 1.0 / NUM)
        assert evidence.log_partition[k] == pytest.approx(
            truth.log_partition[k], abs=STANDARD_ERRORS * spread + 1e-3
        )


def entered_by(evidence: Evidence, k: int) -> np.ndarray:
    """Return which hypotheses [N, H] the trajectories of a task enter."""
    return unpack(evidence.samples.violations[k], len(evidence.problem.hypotheses))


def weights_avoiding(evidence: Evidence, k: int, avoiding: Sequence[int]) -> np.ndarray:
    """Return log-weights [N] of the trajectories of a task, -inf where one enters any of a set."""
    entered = entered_by(evidence, k)[:, list(avoiding)].any(axis=1)
    return np.where(entered, -np.inf, evidence.log_weight[k])


def spread_of(log_weight: np.ndarray) -> float:
    """Return the standard error of the log of a mean of weights, at most as of counting them."""
    ess = estimators.effective_sample_size(log_weight)
    return math.sqrt(max(1.0 / ess - 1.0 / len(log_weight), 0.0))


@pytest.mark.parametrize("solver", [GRID, SMALL_PPO], ids=lambda solver: solver.name)
@pytest.mark.parametrize("name", CASES)
def test_sampling_agrees_with_enumeration(name: str, solver: Solver) -> None:
    """Several tasks at once, and hypotheses about actions, about both, and about the end."""
    assert_within_errors(sampled(name, solver), exact(name), CASES[name].least_ess[solver.name])


@pytest.mark.parametrize("name", CASES)
def test_equal_weights_of_a_good_policy_agree_with_enumeration(name: str) -> None:
    """Within Hoeffding's bound, and what the policy's divergence from pi_0 adds (Pinsker)."""
    evidence = sampled(name, GRID).weighted("plain")
    difference = np.abs(evidence.violation_probability - exact(name).violation_probability)
    bias = np.sqrt(0.5 * np.maximum(evidence.kl, 0.0))
    assert bias[0] < 0.1
    assert (difference.max(axis=1) < evidence.hoeffding_error(0.9999) + bias).all()


@pytest.mark.parametrize("solver", [GRID, SMALL_PPO], ids=lambda solver: solver.name)
@pytest.mark.parametrize("name", CASES)
def test_sets_of_hypotheses_agree_with_enumeration(name: str, solver: Solver) -> None:
    """Which hypotheses one and the same trajectory enters: they do not go by chance together."""
    evidence, truth = sampled(name, solver), exact(name)
    by_chance = []
    for k, expected in enumerate(pairs(name)):
        for pair, value in expected.items():
            clean = weights_avoiding(evidence, k, pair)
            if value - truth.log_partition[k] < math.log(0.02):
                continue
            error = STANDARD_ERRORS * spread_of(clean)
            assert estimators.log_partition(clean) == pytest.approx(value, abs=error + 1e-3)
            alone = truth.log_partition[k] + truth.log_ratio[k, list(pair)].sum()
            by_chance.append(abs(value - alone) < error + 1e-3)
    assert len(by_chance) >= 20
    assert np.mean(by_chance) < 0.5


# -- greedy selection ----------------------------------------------------------------------------


class Choice(NamedTuple):
    """A step of greedy selection worked out by sums over sets.

    Attributes:
      gain: [H] nats a demonstration; -inf where ruled out.
      log_partition: [K] log Z_C of each task with the best one in force.
    """

    gain: np.ndarray
    log_partition: np.ndarray

    @property
    def best(self) -> int:
        return int(self.gain.argmax())

    @property
    def margin(self) -> float:
        """By how much the best beats the next, nats."""
        return float(np.diff(np.sort(self.gain)[-2:])[0])


def choose(
    nominal: EnumerationNominal | TableNominal, start: Inference, picked: Sequence[int]
) -> Choice:
    """Choose one more on top of some, given which tasks there are and what was entered."""
    sets = [list(picked), *([*picked, c] for c in range(start.entered.shape[1]))]
    tasks = zip(*start.evidence.tasks, strict=True)
    values = np.array([nominal.log_partition(Task(*task), sets) for task in tasks])
    gain = start.task_counts @ (values[:, :1] - values[:, 1:]) / start.task_counts.sum()
    gain[start.entered.any(axis=0) | ~np.isfinite(gain)] = -np.inf
    gain[list(picked)] = -np.inf
    return Choice(gain, values[:, 1 + int(gain.argmax())])


def draws_of(
    nominal: EnumerationNominal | TableNominal, tasks: Task, num: int
) -> list[Demonstration]:
    """Return demonstrations drawn from the exact distribution of a problem, some of each task."""
    evidence = sample(nominal, tasks)
    length, mdp = evidence.samples.length, nominal.problem.mdp
    made = []
    for k, task in enumerate(zip(*evidence.tasks, strict=True)):
        for i in range(num):
            states = evidence.samples.kept[k, i, : length[k, i] + 1]
            change = np.diff(states, axis=0)[:, -len(mdp.action_names) :]
            made.append(Demonstration(f"{k}-{i}", states, Task(*task), actions=change / mdp.dt))
    return made


def test_greedy_of_tables_is_what_sums_over_sets_say() -> None:
    problem = world(known=KNOWN)
    tasks = Task(np.array([[0.0, 0.0], [0.0, 2.0]]), np.array([[3.0, 2.0], [3.0, 1.0]]))
    obeyed = [*KNOWN, cell_box((2, 2)), move_box("down-right")]
    made = draws_of(tabulated(dataclasses.replace(problem, known=obeyed)), tasks, 20)
    start = infer(sample(tabulated(problem), tasks), made)
    picks = greedy(start, tabulated(problem), threshold=0.01)
    assert len(picks) >= 3
    for k, pick in enumerate(picks):
        choice = choose(tabulated(problem), start, [p.hypothesis for p in picks[:k]])
        assert choice.gain[pick.hypothesis] == pytest.approx(choice.gain.max(), abs=1e-12)
        assert pick.gain == pytest.approx(choice.gain.max(), abs=1e-12)
        if choice.margin > 1e-9:
            np.testing.assert_allclose(pick.log_partition, choice.log_partition, atol=1e-12)
    last = choose(tabulated(problem), start, [p.hypothesis for p in picks])
    assert last.gain.max() < 0.01


def gain_error(start: Inference, picked: Sequence[int], c: int) -> float:
    """Return the standard error of the gain of hypothesis c on top of some, nats."""
    variance = 0.0
    for k, share in enumerate(start.task_counts / start.task_counts.sum()):
        weight = estimators.normalise(weights_avoiding(start.evidence, k, picked))
        avoids = ~entered_by(start.evidence, k)[:, c]
        probability = weight @ avoids
        variance += (share / probability) ** 2 * (weight**2 @ (avoids - probability) ** 2)
    return math.sqrt(variance)


def assert_greedy_agrees(
    evidence: Evidence,
    nominal: EnumerationNominal | TableNominal,
    made: Sequence[Demonstration],
    least: int,
) -> None:
    """The same picks in order for as long as sampling can tell them apart, `least` at least."""
    start = infer(evidence, made)
    agreed: list[int] = []
    exact = infer(sample(nominal, evidence.tasks), made)
    truth = greedy(exact, nominal, threshold=0.02)
    for pick, exactly in zip(greedy(start, threshold=0.02), truth, strict=False):
        choice = choose(nominal, start, agreed)
        assert exactly.gain == pytest.approx(choice.gain.max(), abs=1e-9)
        error = STANDARD_ERRORS * gain_error(start, agreed, choice.best)
        if choice.margin < 2.0 * error:
            break
        assert pick.hypothesis == exactly.hypothesis == choice.best
        assert pick.gain == pytest.approx(choice.gain.max(), abs=error + 1e-3)
        agreed.append(pick.hypothesis)
        for k, value in enumerate(choice.log_partition):
            spread = STANDARD_ERRORS * spread_of(weights_avoiding(evidence, k, agreed))
            assert pick.log_partition[k] == pytest.approx(value, abs=spread + 1e-3)
    assert len(agreed) >= least


@pytest.mark.parametrize(
    ("name", "hidden", "least"), [("pendulum", [4, 6], 2), ("cart", [5, 9], 2)], ids=list(CASES)
)
def test_greedy_of_samples_agrees_with_enumeration(
    name: str, hidden: list[int], least: int
) -> None:
    problem, tasks, _ = CASES[name]
    obeyed = [*problem.known, *(problem.hypotheses.constraint(k) for k in hidden)]
    made = draws_of(enumerated(dataclasses.replace(problem, known=obeyed)), tasks, 10)
    assert_greedy_agrees(sampled(name, GRID), enumerated(problem), made, least)


# -- Theorem 1 -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("solve", "problem", "task"),
    [
        (tabulated, world(), WORLD_TASK),
        (tabulated, world(known=KNOWN, measure="counting", between_states=False), WORLD_TASK),
        (tabulated, routes(LatticeRoutes(toll=1.5)), TASK),
        (enumerated, short_pendulum(between_states=False), PENDULUM_TASK),
        (enumerated, CART.problem, CART_TASK),
        (enumerated, dataclasses.replace(CART.problem, measure="counting"), CART_TASK),
    ],
)
def test_the_ratio_of_partition_functions_is_the_probability_of_avoiding(
    solve, problem: Problem, task: Task
) -> None:
    """Theorem 1: Z_c / Z_0 by leaving out, by solving with c known, and as P(avoid c)."""
    evidence = sample(solve(problem), task)
    avoid = evidence.summary.avoid_probability[0]
    assert np.count_nonzero(is_open(avoid)) >= 4
    singles = solve(problem).log_partition(task, [[], *([c] for c in range(len(avoid)))])
    np.testing.assert_allclose(np.exp(singles[1:] - singles[0]), avoid, rtol=1e-9)
    for c in np.argsort(np.abs(avoid - 0.5))[:2]:
        known = [*problem.known, problem.hypotheses.constraint(c)]
        solved = solve(dataclasses.replace(problem, known=known)).log_partition(task, [[]])[0]
        assert solved == pytest.approx(singles[1 + c], abs=1e-9)


@pytest.mark.parametrize("measure", ["uniform", "counting"])
def test_what_is_avoided_together_is_avoided_one_after_another(measure: str) -> None:
    """Z_{a,c} / Z_a = P(avoid c | avoid a), both with a in force and with a known."""
    problem = world(measure=measure)
    nominal = tabulated(problem)
    for a in (0, 1, 8, 17):
        given = nominal.answer(WORLD_TASK, np.random.default_rng(0), avoiding=[a])
        hypotheses = range(len(problem.hypotheses))
        both = nominal.log_partition(WORLD_TASK, [[a, c] for c in hypotheses])
        np.testing.assert_allclose(
            given.avoid_probability, np.exp(both - given.log_partition), rtol=1e-9
        )
        known = dataclasses.replace(problem, known=[problem.hypotheses.constraint(a)])
        solved = sample(tabulated(known), WORLD_TASK)
        np.testing.assert_allclose(solved.summary.avoid_probability[0], given.avoid_probability)
        assert given.avoid_probability[a] == pytest.approx(1.0, abs=1e-12)


# -- Theorem 2 -----------------------------------------------------------------------------------


class Paths(NamedTuple):
    """All trajectories of a problem.

    Attributes:
      total_reward: [N] exact.
      length: [N].
      entered: [N, H].
    """

    total_reward: np.ndarray
    length: np.ndarray
    entered: np.ndarray


def paths_of_routes() -> tuple[Problem, Task, Paths]:
    problem = routes(Routes(toll=1.5))
    moves = np.array(list(itertools.product([-1.0, 0.0, 1.0], repeat=NUM_STEPS)))
    y = MIDDLE + np.cumsum(np.pad(moves, ((0, 0), (1, 0))), axis=1)
    states = np.stack([np.broadcast_to(np.arange(NUM_STEPS + 1.0), y.shape), y], axis=-1)
    reward = -0.25 * (moves**2).sum(axis=1) - 0.125 * (y[:, -1] - MIDDLE) ** 2
    reward -= 1.5 * (y[:, 4] > MIDDLE)
    space = problem.mdp.space
    allowed = ~violates(WALL, states, space, problem.between_states)
    bits = problem.hypotheses.violations(states[allowed], space, problem.between_states)
    entered = unpack(bits, len(problem.hypotheses))
    length = np.full(allowed.sum(), NUM_STEPS)
    return problem, TASK, Paths(reward[allowed], length, entered)


def paths_of_world() -> tuple[Problem, Task, Paths]:
    """Cells and moves alone are hypothesised, and only cells that a walker stands on count."""
    mdp = Gridworld(3, 3, 5, step_reward=-0.375, walls=((1, 1),))
    problem = Problem(mdp, mdp.hypotheses(), between_states=False)
    found: list[tuple[int, set[int]]] = []

    def go(place: tuple[int, int], length: int, entered: set[int]) -> None:
        entered = entered | {3 * place[1] + place[0]}
        if place == (2, 2):
            found.append((length, entered))
        elif length < mdp.num_steps:
            for a, (dx, dy) in enumerate(MOVES.values()):
                ahead = (place[0] + dx, place[1] + dy)
                if ahead != (1, 1) and min(ahead) >= 0 and max(ahead) < 3:
                    go(ahead, length + 1, entered | {9 + a})

    go((0, 0), 0, set())
    entered = np.array([[h in path for h in range(17)] for _, path in found])
    length = np.array([length for length, _ in found])
    task = Task(np.array([0.0, 0.0]), np.array([2.0, 2.0]))
    return problem, task, Paths(-0.375 * length, length, entered)


@pytest.mark.parametrize("measure", ["uniform", "counting"])
@pytest.mark.parametrize(
    ("solve", "make"),
    [(enumerated, paths_of_routes), (enumerated, paths_of_world), (tabulated, paths_of_world)],
)
def test_another_temperature_is_an_expectation_at_this_one(solve, make, measure: str) -> None:
    """Theorem 2: Z_{d,c} / Z_{s,c} = E_{pi_{s,c}}[exp((beta_d - beta_s) R)]."""
    problem, task, paths = make()
    sets = [[], *([c] for c in range(len(problem.hypotheses))), [1, 3], [2, 5, 7]]
    demonstrated, sampled_at = (
        solve(dataclasses.replace(problem, beta=beta, measure=measure)).log_partition(task, sets)
        for beta in (1.75, 0.5)
    )
    log_weight = 0.5 * paths.total_reward
    if measure == "uniform":
        log_weight = log_weight - paths.length * math.log(problem.mdp.num_actions)
    ratios = []
    for k, avoiding in enumerate(sets):
        clean = ~paths.entered[:, avoiding].any(axis=1)
        if not clean.any():
            assert sampled_at[k] == demonstrated[k] == -math.inf
            continue
        assert sampled_at[k] == pytest.approx(np.logaddexp.reduce(log_weight[clean]), abs=1e-9)
        weight = estimators.normalise(log_weight[clean])
        expectation = weight @ np.exp(1.25 * paths.total_reward[clean])
        assert demonstrated[k] - sampled_at[k] == pytest.approx(math.log(expectation), abs=1e-9)
        ratios.append(demonstrated[k] - sampled_at[k])
    assert len(ratios) >= 12
    assert np.ptp(ratios) > 0.1


@pytest.mark.parametrize("name", CASES)
def test_samples_of_one_temperature_answer_for_another(name: str) -> None:
    problem, tasks, _ = CASES[name]
    evidence, beta = sampled(name, GRID), problem.beta
    hotter, colder = (
        (factor * beta, sample(enumerated(dataclasses.replace(problem, beta=factor * beta)), tasks))
        for factor in (0.2, 2.0)
    )
    tried = 0
    for other, truth in (hotter, colder):
        assert np.abs(truth.violation_probability - exact(name).violation_probability).max() > 0.05
        for k, c in itertools.product(range(evidence.num_tasks), range(len(problem.hypotheses))):
            clean = weights_avoiding(evidence, k, [c])
            if not np.isfinite(clean).any():
                continue
            tilted = clean + (other - beta) * evidence.samples.total_reward[k]
            if estimators.effective_sample_size(tilted) < 400.0:
                continue
            tried += 1
            found = estimators.log_partition(tilted) - estimators.log_partition(clean)
            here, there = (e.log_partition[k] + e.log_ratio[k, c] for e in (exact(name), truth))
            error = STANDARD_ERRORS * (spread_of(tilted) + spread_of(clean))
            assert found == pytest.approx(there - here, abs=error + 1e-3)
    assert tried >= evidence.num_tasks * len(problem.hypotheses)


# -- two routes ----------------------------------------------------------------------------------

BOTH = routes(Routes(toll=1.0))
LATTICE = routes(LatticeRoutes(toll=1.0))


@cache
def truth_of_routes() -> Evidence:
    """Return what is so of both, the formula and the table."""
    return sample(tabulated(LATTICE), TASK)


@pytest.mark.parametrize("beta", [1e-9, 1.0, 2.5])
@pytest.mark.parametrize("measure", ["uniform", "counting"])
def test_the_odds_of_two_routes_are_those_of_the_toll(measure: str, beta: float) -> None:
    for solve, mdp in ((enumerated, Routes(toll=1.0)), (tabulated, LatticeRoutes(toll=1.0))):
        problem = routes(mdp, measure=measure, beta=beta)
        above, below = sample(solve(problem), TASK).violation_probability[0, :2]
        assert above == pytest.approx(share_above(problem), abs=1e-12)
        assert above + below == pytest.approx(1.0, abs=1e-12)


def test_a_policy_of_pi_0_itself_is_weighed_as_such() -> None:
    evidence = sample(Planted(LATTICE, LATTICE), TASK, NUM, method="importance")
    truth = truth_of_routes()
    assert np.ptp(evidence.importance_log_weight) < 1e-4
    assert evidence.log_partition[0] == pytest.approx(truth.log_partition[0], abs=1e-5)
    difference = evidence.violation_probability - truth.violation_probability
    assert np.abs(difference).max() < evidence.weighted("plain").hoeffding_error(0.9999)


@pytest.mark.parametrize(("kept", "closed"), [(0, ABOVE), (1, BELOW)], ids=["below", "above"])
def test_a_route_never_taken_is_not_seen_by_any_diagnostic(kept: int, closed: Box) -> None:
    """pi_0 of half of the modes has equal weights too: wrong by far, and sure of itself."""
    half = dataclasses.replace(LATTICE, known=[WALL, closed])
    evidence = sample(Planted(LATTICE, half), TASK, NUM)
    truth = truth_of_routes()
    missed = truth.violation_probability[0, kept]
    assert 0.2 < missed < 0.8
    assert evidence.effective_sample_size[0] > 0.999 * NUM
    assert abs(evidence.kl[0]) < 1e-5
    assert all("only a lower bound" in text for text in infer(evidence, []).warnings)
    assert evidence.violation_probability[0, kept] == 0.0
    assert evidence.standard_error[0, kept] < 1e-3
    expected = truth.log_partition[0] + math.log(1.0 - missed)
    assert evidence.log_partition[0] == pytest.approx(expected, abs=1e-5)


def assert_both_routes(evidence: Evidence) -> None:
    """The mass of the route above is right, and so are the cells on either side."""
    truth = truth_of_routes()
    ess = evidence.effective_sample_size[0]
    assert ess > 0.2 * NUM
    error = np.sqrt(evidence.summary.avoid_variance[0]) + 1.0 / ess
    difference = evidence.violation_probability[0] - truth.violation_probability[0]
    assert np.abs(difference / error).max() < STANDARD_ERRORS
    assert error[0] < 0.02
    assert 0.2 < share_above(BOTH) < 0.3


@pytest.mark.parametrize("method", METHODS)
def test_the_grid_solver_takes_both_routes(method: str) -> None:
    evidence = sample(learn(BOTH, GRID), TASK, NUM, method=method)
    assert evidence.kl[0] < 1e-4
    assert_both_routes(evidence)


def test_ppo_takes_both_routes() -> None:
    assert_both_routes(sample(learn(BOTH, SMALL_PPO), TASK, NUM))


@pytest.mark.parametrize(("solve", "problem"), [(enumerated, BOTH), (tabulated, LATTICE)])
def test_exact_draws_take_both_routes(solve, problem: Problem) -> None:
    answers = [sample(solve(problem), TASK, seed=seed) for seed in range(20)]
    bits = np.concatenate([answer.samples.violations[0] for answer in answers])
    assert len(bits) == 20 * NUM_KEPT
    assert_shares(unpack(bits, len(problem.hypotheses)), answers[0].violation_probability[0])


def assert_shares(entered: np.ndarray, probability: np.ndarray) -> None:
    """Equal draws [N, H] enter hypotheses as often as they should."""
    variance = np.maximum(probability * (1.0 - probability), 0.0)
    error = np.sqrt(variance / len(entered)) + 1.0 / len(entered)
    assert np.abs((entered.mean(axis=0) - probability) / error).max() < STANDARD_ERRORS


def test_demonstrations_take_both_routes() -> None:
    """The wall is what demonstrators know and the model does not."""
    unaware = dataclasses.replace(BOTH, known=[])
    tasks = Task(*(np.repeat(x[None], 400, axis=0) for x in TASK))
    made = demonstrate(unaware, WALL, tasks, solver=GRID)
    bits = BOTH.hypotheses.violations(
        np.array([one.states for one in made]), BOTH.mdp.space, BOTH.between_states
    )
    truth = truth_of_routes().violation_probability[0]
    assert_shares(unpack(bits, len(BOTH.hypotheses)), truth)


def test_greedy_of_an_exact_policy_agrees_with_tables() -> None:
    unaware = routes(LatticeRoutes(toll=1.0), known=[])
    hypotheses = [Box(x=(3.5, 4.5), y=(y - 0.5, y + 0.5)) for y in range(4, HEIGHT - 4)]
    unaware = dataclasses.replace(unaware, hypotheses=hypotheses, between_states=False)
    obeyed = dataclasses.replace(unaware, known=[Box(x=(3.5, 4.5), y=(6.5, 8.5)), BELOW])
    made = draws_of(tabulated(obeyed), Task(*(x[None] for x in TASK)), 40)
    assert_greedy_agrees(sample(Planted(unaware, unaware), TASK, NUM), tabulated(unaware), made, 3)
