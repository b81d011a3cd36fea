"""Training names the method of an MDP, or the network, that returns bad numbers."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.brief_training import READ, SOLVERS, each_solver, new_run
from support.reference import Cart, short_pendulum

from swerve import PPO, Box, Problem, SoftValue, grid, learn
from swerve.solvers.trained.lanes import Lanes, fresh_lanes
from swerve.solvers.trained.nonfinite import check_steps
from swerve.solvers.trained.probe import Probe, Reading
from swerve.solvers.trained.run import NUM_RISEN
from swerve.solvers.trained.training import TrainedNominal, TrainingSolver


class Broken(Cart):
    """Returns no number in one place."""

    broken: str = eqx.field(default="reward", static=True)

    def value(self, name: str, is_broken, value):
        return jnp.where(is_broken & (name == self.broken), jnp.nan, value)

    def dynamics(self, state, action):
        following = super().dynamics(state, action)
        return self.value("dynamics", (state[0] > 1.0) & (action[0] > 0), following)

    def reward(self, state, action, next_state, goal):
        value = super().reward(state, action, next_state, goal)
        return self.value("reward", (state[0] > 1.0) & (action[0] > 0), value)

    def terminal_reward(self, state, goal):
        value = super().terminal_reward(state, goal)
        return self.value("terminal_reward", state[0] > 1.5, value)

    def features(self, state, step, goal):
        return self.value("features", state[0] > 1.0, super().features(state, step, goal))

    def sample_state(self, key):
        value = super().sample_state(key)
        return self.value("sample_state", value[0] > 1.0, value)


STATE = r"from state \[1\.\d+, -?\d\S*\] with goal \[\S+, \S+\]"
MESSAGES = {
    "dynamics": rf"Broken\.dynamics returned \[nan, nan\] at step \d {STATE} with action 2, \[1\]",
    "reward": rf"Broken\.reward returned nan at step \d {STATE} with action 2, \[1\]: expected",
    "terminal_reward": r"Broken\.terminal_reward returned nan at step \d .* with action",
    "features": rf"Broken\.features returned \[nan.* at step \d {STATE}: expected finite",
    "sample_state": r"Broken\.sample_state or sample_task returned \[nan, nan, .* at step \d: exp",
}


class TestBadNumbers:
    @each_solver
    def test_are_traced_to_the_mdp(self, solver: TrainingSolver) -> None:
        problem = Problem(Broken(), grid(x=(-1.5, 1.5, 3)))
        with pytest.raises(ValueError, match=MESSAGES["reward"]):
            learn(problem, solver)

    @pytest.mark.parametrize("broken", MESSAGES)
    def test_are_traced_to_the_method(self, broken: str) -> None:
        problem = Problem(Broken(broken=broken), grid(x=(-1.5, 1.5, 3)))
        lanes = fresh_lanes(problem, jax.random.key(0), 50, explore=1.0)
        with pytest.raises(ValueError, match=MESSAGES[broken]):
            check_steps(problem, Lanes(*(x[None] for x in lanes)))

    def test_the_first_step_is_to_blame(self) -> None:
        """What comes later may follow from it; a reward of -inf is none."""

        class Steps(Cart):
            def reward(self, state, action, next_state, goal):
                return jnp.where(state[0] > 0.25, jnp.nan, jnp.where(state[0] < 0, -jnp.inf, 0.0))

        problem = Problem(Steps(), grid(x=(-1.5, 1.5, 3)))
        x = jnp.array([[-0.1, 0.2], [0.1, 0.3], [0.4, 0.5]])  # [L, N]
        states, goals = jnp.stack([x, 0 * x], axis=1), jnp.zeros((3, 2, 2))
        steps = jnp.arange(3)[:, None] + jnp.array([0, 4])
        with pytest.raises(ValueError, match=r"nan at step 5 from state \[0\.3, 0\] .* action 0, "):
            check_steps(problem, Lanes(states, steps, goals))
        check_steps(problem, Lanes(states[:1], steps[:1], goals[:1]))

    def test_of_rewards_that_nobody_is_paid_do_not_count(self) -> None:
        lanes = Lanes(jnp.array([[[1.2], [0.0]]]), jnp.zeros((1, 1)), jnp.zeros((1, 2, 1)))
        problem = Problem(Broken(), grid(x=(-1.5, 1.5, 3)), between_states=False)
        with pytest.raises(ValueError, match=r"Broken\.reward returned nan"):
            check_steps(problem, lanes)
        check_steps(dataclasses.replace(problem, known=[Box(x=(0.9, 9.0))]), lanes)

    @each_solver
    def test_of_the_network_are_divergence(
        self, solver: TrainingSolver, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """What was learned before it is kept; if that is nothing, it is an error."""
        monkeypatch.setattr(Probe, "read", lambda self, policies: READ)
        problem = short_pendulum()
        kept = new_run(solver, problem, 3, None)
        for _ in range(2):
            kept.advance()
        trainer = type(solver.trainer(problem, 3))
        run = trainer.run

        def spoil(after: int):
            def spoiled(self, state, num_iterations):
                late = state.iteration >= after * solver.chunk_iterations
                state, info = run(self, state, num_iterations)
                spoilt = jax.tree.map(lambda x: jnp.where(late, jnp.nan, x).astype(x.dtype), state)
                return spoilt, info

            monkeypatch.setattr(trainer, "run", spoiled)

        spoil(2)
        with pytest.warns(RuntimeWarning, match=r"diverged after \d+ iterations.* before that is"):
            nominal = learn(problem, solver, seed=3)
        assert isinstance(nominal, TrainedNominal)
        assert len(nominal.history) == 2
        for ours, theirs in zip(
            jax.tree.leaves(nominal.policy), jax.tree.leaves(kept.policy), strict=True
        ):
            np.testing.assert_array_equal(ours, theirs)
        spoil(0)
        with pytest.raises(ValueError, match=r"diverged after 0 iterations: .* Pendulum returned"):
            learn(problem, solver, seed=3)

    @each_solver
    @pytest.mark.parametrize("later", [[9.0] * NUM_RISEN, [0.6, 9.0]], ids=["early", "at the end"])
    def test_a_rise_of_the_divergence_is_too(
        self, solver: PPO | SoftValue, later: list[float], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """What was learned up to the least KL is kept."""
        problem, at_end = short_pendulum(), len(later) < NUM_RISEN
        if at_end:  # a run of four chunks
            solver = dataclasses.replace(solver, num_steps=4 * solver.num_lanes * solver.segment)
        readings = [5.0, 0.5, *later]
        planned = iter([*readings, *readings[:2]])  # of both runs
        monkeypatch.setattr(Probe, "read", lambda self, _: Reading(next(planned), 9.0, 0.1))
        with pytest.warns(
            RuntimeWarning, match=r"diverged: .* 9 nats .* least KL, 0\.5 .* after 2 c"
        ):
            nominal = learn(problem, solver, seed=3)
        assert isinstance(nominal, TrainedNominal)
        assert nominal.history[:, 2].tolist() == readings
        kept = new_run(nominal.solver, problem, 3, None)
        for _ in range(2):
            kept.advance()
        for ours, theirs in zip(
            jax.tree.leaves(nominal.policy), jax.tree.leaves(kept.policy), strict=True
        ):
            np.testing.assert_array_equal(ours, theirs)

    def test_a_run_that_gets_nowhere_is_told(self) -> None:
        """By a learning rate that throws every value to its bound, where no gradient leads back."""
        solver = dataclasses.replace(SOLVERS["soft-value"], learning_rate=30.0)
        with pytest.warns(RuntimeWarning, match=r"no nearer to pi_0: KL .* from 30"):
            learn(short_pendulum(), solver, seed=3)
