"""The table of solvers: each line is true of its class, and one more line is one more solver."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from support.reference import CART_TASK, short_cart

from swerve import (
    Grid,
    Problem,
    SoftPaths,
    Tabular,
    infer,
    learn,
    load_nominal,
    load_problem,
    sample,
    save_nominal,
)
from swerve.base.solver_kinds import (
    KINDS,
    UNKNOWN,
    SolverKind,
    kind_named,
    kind_stored,
    solver_names,
    suggested_solver,
)
from swerve.base.store import StoreError
from swerve.evidence.exact import ExactNominal
from swerve.simulation.policies import ValuedPolicy
from swerve.simulation.trajectory import Policy
from swerve.solvers.base import AdaptingSolver, LearnOptions, PolicyNominal, Solver
from swerve.solvers.learn import resolve_solver
from swerve.solvers.trained.settings import TrainingSettings
from swerve.solvers.trained.training import TrainedNominal

TINY = "num_steps=64&num_lanes=8&segment=8&num_minibatches=1&num_epochs=1&width=4"
TEXTS = {  # quick settings of each solver
    "grid": "grid?num_points=21",
    "ppo": f"ppo?{TINY}",
    "soft-value": f"soft-value?{TINY}",
    "distilled": f"distilled?{TINY}",
    "discrete": "discrete?num_cells=9&hold=1",
}


@dataclass(frozen=True)
class Coin(Solver["CoinNominal"]):
    """Toss a coin: a policy that takes each action with the same probability.

    Attributes:
      tilt: by how many nats the last action is more likely than the others.
    """

    tilt: float = 0.0

    name = "coin"

    def _learn(self, problem: Problem, options: LearnOptions) -> CoinNominal:
        return CoinNominal(problem, self, options.seed)

    def check(self, problem: Problem) -> None:
        self.check_dimensions(problem)

    def restore(self, problem: Problem, arrays: dict[str, np.ndarray]) -> CoinNominal:
        return CoinNominal(problem, self, int(arrays["seed"]))


@dataclass(frozen=True, eq=False)
class CoinNominal:
    problem: Problem
    solver: Coin
    seed: int

    def arrays(self) -> dict[str, np.ndarray]:
        return {"seed": np.array(self.seed)}

    def policies(
        self, goals: np.ndarray, advance: Callable[[float], None] = lambda share: None
    ) -> Iterator[Policy]:
        tilted = jnp.zeros(self.problem.mdp.num_actions).at[-1].set(self.solver.tilt)
        log_probabilities = tilted - jnp.log(jnp.exp(tilted).sum())
        for _ in goals:
            advance(1.0)
            yield lambda state, step, goal: log_probabilities


@pytest.fixture
def coin(monkeypatch: pytest.MonkeyPatch) -> SolverKind:
    """One more line of the table."""
    kind = SolverKind(f"{__name__}:Coin", max_dimensions=2)
    monkeypatch.setitem(KINDS, "coin", kind)
    return kind


def problem_for(name: str) -> Problem:
    """A problem that a solver takes."""
    if KINDS[name].needs_tables:
        return load_problem("gridworld?width=3&height=3&num_steps=4")
    if name == "soft-paths":
        world = load_problem("gridworld?width=3&height=3&num_steps=40")
        return dataclasses.replace(world, beta=5.0, measure="uniform")
    return short_cart()


class TestOneMoreSolver:
    def test_learns_samples_saves_and_loads(self, coin: SolverKind, tmp_path: Path) -> None:
        problem = short_cart()
        nominal = learn(problem, "coin?tilt=0.5", seed=3)
        assert nominal.solver == Coin(0.5)
        assert nominal.solver.kind is coin
        save_nominal(tmp_path / "coin.nominal", nominal)
        again = load_nominal(tmp_path / "coin.nominal", problem)
        assert isinstance(again, CoinNominal)
        assert (again.solver, again.seed) == (Coin(0.5), 3)
        first, second = (sample(one, CART_TASK, 200, seed=1) for one in (nominal, again))
        assert first.method == "importance"
        assert kind_stored(first.solver) is coin
        np.testing.assert_array_equal(first.log_weight, second.log_weight)
        assert len(infer(first).ranking) > 0

    def test_is_checked_and_listed(self, coin: SolverKind) -> None:
        assert "coin" in solver_names(lambda kind: not kind.is_exact)
        with pytest.raises(ValueError, match="no parameter 'sides'; there are tilt"):
            learn(short_cart(), "coin?sides=3")
        with pytest.raises(ValueError, match=r"no solver named 'dice'; there are grid, .*, coin"):
            learn(short_cart(), "dice")
        with pytest.raises(ValueError, match="the coin solver takes at most 2 state dimensions"):
            learn(load_problem("car"), "coin")

    def test_is_not_told_to_train_longer(self, coin: SolverKind) -> None:
        evidence = sample(learn(short_cart(), "coin?tilt=9"), CART_TASK, 400, seed=1)
        [warning] = [text for text in infer(evidence).warnings if "not to be trusted" in text]
        assert "use a solver that comes nearer to pi_0 (grid and soft-value)" in warning
        assert "num_steps" not in warning

    def test_that_left_is_named_by_its_files(self, coin: SolverKind, tmp_path: Path) -> None:
        save_nominal(tmp_path / "coin.nominal", learn(short_cart(), "coin"))
        del KINDS["coin"]
        with pytest.raises(StoreError, match="'coin'"):
            load_nominal(tmp_path / "coin.nominal", short_cart())


@pytest.mark.parametrize("name", KINDS)
class TestKind:
    def test_is_that_of_the_class(self, name: str) -> None:
        kind, solver = KINDS[name], resolve_solver(TEXTS.get(name, name))
        assert isinstance(solver, Solver)
        assert solver.name == name
        assert solver.kind is kind_named(TEXTS.get(name, name)) is kind_stored(repr(solver)) is kind
        assert isinstance(solver, AdaptingSolver) == kind.adapts
        assert isinstance(solver, TrainingSettings) == kind.is_trained
        assert hasattr(solver, "imitate") == bool(kind.teacher)
        settings = [field.name for field in dataclasses.fields(solver)]  # pyright: ignore
        assert not kind.finer or kind.finer in settings
        assert not kind.teacher or KINDS[kind.teacher].has_soft_value
        assert not (kind.is_exact and (kind.has_soft_value or kind.is_trained))

    @pytest.mark.filterwarnings("ignore:training")  # a run of one chunk
    def test_is_that_of_what_is_learned(self, name: str) -> None:
        kind, problem = KINDS[name], problem_for(name)
        solver = resolve_solver(TEXTS.get(name, name))
        if kind.teacher:
            teacher = learn(problem, TEXTS[kind.teacher])
            nominal = solver.imitate(teacher)  # pyright: ignore[reportAttributeAccessIssue]
        else:
            nominal = learn(problem, solver)
        assert isinstance(nominal, ExactNominal) == kind.is_exact
        assert isinstance(nominal, PolicyNominal) != kind.is_exact
        assert isinstance(nominal, TrainedNominal) == kind.is_trained
        if isinstance(nominal, PolicyNominal):
            policy = next(iter(nominal.policies(np.asarray(CART_TASK.goal)[None])))
            assert isinstance(policy, ValuedPolicy) == kind.has_soft_value

    def test_says_what_dimensions_it_takes(self, name: str) -> None:
        kind, double = KINDS[name], load_problem("double-pendulum")
        solver = resolve_solver(name)
        if kind.max_dimensions < 4:
            with pytest.raises(ValueError, match="takes at most"):
                solver.check(double)
        if kind.needs_tables:
            with pytest.raises(ValueError, match="needs a tabular MDP"):
                solver.check(double)


def test_unknown_solvers_are_taken_for_sampled_ones() -> None:
    assert kind_named("dice?sides=6") is kind_stored("Dice(sides=6)") is UNKNOWN
    assert UNKNOWN.default_method == "importance"
    assert not UNKNOWN.has_soft_value


@pytest.mark.parametrize(
    ("is_tabular", "num_dimensions", "expected"),
    [(True, 2, "tabular"), (False, 3, "grid"), (False, 4, "soft-value")],
)
def test_suggested_solver(is_tabular: bool, num_dimensions: int, expected: str) -> None:
    assert suggested_solver(is_tabular, num_dimensions) == expected


def test_one_signature_serves_all_solvers() -> None:
    problem = problem_for("tabular")
    for solver in (Tabular(), SoftPaths(), Grid()):
        assert type(solver).learn is Solver.learn
    nominal = Tabular().learn(problem, tasks=None, seed=0, progress=False, checkpoint=None)
    assert nominal.problem is problem
