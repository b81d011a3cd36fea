"""The history of training: its rows, its file, and how training goes on from a checkpoint."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.brief_training import READ, SOLVERS, each_solver, new_run, trained
from support.reference import short_pendulum
from support.training import Interrupted

from swerve import PPO, SoftValue, Task, learn, load_nominal, save_nominal
from swerve.base import store
from swerve.solvers.trained.checkpoints import Checkpoint
from swerve.solvers.trained.probe import Probe, Progress, Reading
from swerve.solvers.trained.training import TrainedNominal, TrainingSolver


class TestHistory:
    @each_solver
    def test_has_a_row_for_each_chunk(self, solver: TrainingSolver) -> None:
        history = [Progress(*row) for row in trained(solver).history.tolist()]
        assert len(history) == solver.num_chunks
        expected = solver.chunk_steps * np.arange(1, solver.num_chunks + 1)
        np.testing.assert_array_equal([row.num_steps for row in history], expected)
        assert (np.diff([0.0, *(row.seconds for row in history)]) > 0).all()
        assert history[-1].kl < history[0].kl
        assert all(row.kl <= row.worst_kl for row in history)
        assert all(row.residual > 0 for row in history)

    @each_solver
    def test_is_stored(self, solver: TrainingSolver, tmp_path: Path) -> None:
        nominal = trained(solver)
        save_nominal(tmp_path / "a.nominal", nominal)
        restored = load_nominal(tmp_path / "a.nominal", nominal.problem)
        assert isinstance(restored, TrainedNominal)
        np.testing.assert_array_equal(restored.history, nominal.history)
        for name, array in nominal.arrays().items():
            np.testing.assert_array_equal(restored.arrays()[name], array)

    @each_solver
    def test_goes_on_from_a_checkpoint(
        self, solver: TrainingSolver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        save, kept = Checkpoint.save, []

        def save_and_stop(self: Checkpoint, arrays: dict[str, np.ndarray]) -> None:
            save(self, arrays)
            kept.append(arrays["history"])
            if len(kept) == 5:
                raise Interrupted

        monkeypatch.setattr(Checkpoint, "save", save_and_stop)
        path = tmp_path / "a.checkpoint"
        with pytest.raises(Interrupted):
            learn(short_pendulum(), solver, seed=3, checkpoint=path)
        resumed = learn(short_pendulum(), solver, seed=3, checkpoint=path)
        assert isinstance(resumed, TrainedNominal)
        np.testing.assert_array_equal(resumed.history[:5], kept[4])
        assert (np.diff(resumed.history[:, 0]) > 0).all()
        whole = trained(solver).history
        np.testing.assert_array_equal(resumed.history[:, 1:], whole[:, 1:])

    def test_a_finished_run_does_not_go_on(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(Probe, "read", lambda self, policies: READ)
        solver, path = PPO(num_steps=1, num_lanes=8, segment=1, width=4), tmp_path / "a.checkpoint"
        run = new_run(solver, short_pendulum(), 0, path)
        assert run.advance() is not None
        assert run.advance() is None
        again = new_run(solver, short_pendulum(), 0, path)
        assert again.history == run.history
        assert again.advance() is None

    @each_solver
    def test_of_a_run_that_goes_on_is_of_the_tasks_it_began_with(
        self, solver: TrainingSolver, tmp_path: Path
    ) -> None:
        path, tasks = (
            tmp_path / "a.checkpoint",
            Task(np.array([[2.0, 0.0]]), np.array([[0.5, 0.5]])),
        )
        whole = new_run(solver, short_pendulum(), 3, path, tasks)
        for _ in range(2):
            whole.advance()
        again = new_run(solver, short_pendulum(), 3, path)
        whole.advance()
        again.advance()
        assert [row[2:] for row in again.history] == [row[2:] for row in whole.history]
        anew = new_run(solver, short_pendulum(), 3, None)
        anew.advance()
        assert anew.history[0].kl != whole.history[0].kl

    def test_training_that_gets_no_better_goes_from_the_best_to_its_end(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Chunks 18 to 21 of 31 are passed over, and the third is where it goes on from."""
        solver, problem, path = SOLVERS["soft-value"], short_pendulum(), tmp_path / "a.checkpoint"
        best, settled, first, last = 3, 18, 22, solver.num_chunks
        assert last == 31
        kl = iter([7.0, 4.0, 3.0, *[6.0] * last])
        monkeypatch.setattr(Probe, "read", lambda self, policies: Reading(next(kl), 9.0, 0.1))
        run = new_run(solver, problem, 3, path)
        for _ in range(settled + 2):
            run.advance()
        assert run.num_done == first + 2
        nominal = learn(problem, solver, seed=3, checkpoint=path)
        assert isinstance(nominal, TrainedNominal)
        assert len(nominal.history) == settled + last - first
        assert nominal.history[-1, 1] == len(nominal.history) * solver.chunk_steps
        trainer = solver.trainer(problem, 3)
        state = trainer.initial_state()
        for _ in range(best):
            state, _ = trainer.run(state, solver.chunk_iterations)
        state = trainer.at_iteration(state, first * solver.chunk_iterations)
        for _ in range(last - first):
            state, _ = trainer.run(state, solver.chunk_iterations)
        for ours, theirs in zip(
            jax.tree.leaves(nominal.policy),
            jax.tree.leaves(trainer.policy_of(state)),
            strict=True,
        ):
            np.testing.assert_array_equal(ours, theirs)

    def test_the_end_of_the_schedule_learns_at_a_hundredth_of_the_rate(self) -> None:
        solver = SOLVERS["soft-value"]
        trainer = solver.trainer(short_pendulum(), 3)
        state, _ = trainer.run(trainer.initial_state(), 5)

        def change(iteration: int) -> float:
            before = trainer.at_iteration(state, iteration)
            after, _ = trainer.run(before, 1)
            differences = jax.tree.map(
                lambda x, y: jnp.abs(x - y).mean(),
                trainer.policy_of(before),
                trainer.policy_of(after),
            )
            return float(jnp.mean(jnp.stack(jax.tree.leaves(differences))))

        assert change(solver.num_iterations) == pytest.approx(0.01 * change(5), rel=0.5)

    def test_of_a_span_of_betas_is_that_of_its_worst(self) -> None:
        problem = short_pendulum(beta=0.2)
        solver = SoftValue(num_steps=8_000, num_lanes=16, segment=8, width=8, beta_span=4.0)
        trainer = solver.trainer(problem, 0)
        tried = trainer.probed(trainer.initial_state())
        assert [beta for _, beta in tried] == [0.2, 0.05, 0.8]
        np.testing.assert_allclose([policy.beta for policy, _ in tried], [0.2, 0.05, 0.8], 1e-6)
        probe = Probe(problem, None)
        kl, worst, share = np.array([probe.read([each]) for each in tried]).T
        assert len(set(kl)) == 3
        assert probe.read(tried) == (kl.max(), worst.max(), share.min())

    def test_tasks_are_checked_before_training(self) -> None:
        with pytest.raises(ValueError, match="tasks: expected a goal of 2 numbers"):
            learn(short_pendulum(), SOLVERS["ppo"], tasks=Task([0.0, 0.0], [1.0]))

    def test_of_older_files_is_not_read(self, tmp_path: Path) -> None:
        path = tmp_path / "a.nominal"
        store.write(path, "swerve-nominal", 1, {}, {})
        with pytest.raises(store.StoreError, match="version 1 of kind 'swerve-nominal'"):
            load_nominal(path, short_pendulum())
