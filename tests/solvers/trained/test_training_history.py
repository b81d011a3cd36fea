"""What training leaves behind: its history, a picture of it, and what it says of bad MDPs."""

from __future__ import annotations

import dataclasses
import re
from functools import cache
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.image import imread
from support.command import Run
from support.reference import Cart, short_pendulum
from support.training import Interrupted

from swerve import PPO, Box, Problem, SoftValue, Task, grid, learn, load_nominal, save_nominal
from swerve.base import store
from swerve.solvers.trained.checkpoints import Checkpoint
from swerve.solvers.trained.history_plot import FORBIDDEN, plot_training
from swerve.solvers.trained.lanes import Lanes, fresh_lanes
from swerve.solvers.trained.nonfinite import check_steps
from swerve.solvers.trained.probe import Probe, Reading
from swerve.solvers.trained.run import NUM_RISEN, Progress
from swerve.solvers.trained.run import Run as TrainingRun
from swerve.solvers.trained.training import TrainedNominal, TrainingSolver

SOLVERS = {
    "ppo": PPO(num_steps=20_480, num_lanes=16, segment=8, num_minibatches=2, width=8),
    "soft-value": SoftValue(num_steps=8_000, num_lanes=16, segment=8, width=8),
}
READ = Reading(1.0, 5.0, 0.3)
each_solver = pytest.mark.parametrize("solver", SOLVERS.values(), ids=SOLVERS)


def new_run(
    solver: TrainingSolver,
    problem: Problem,
    seed: int,
    path: Path | None,
    tasks: Task | None = None,
) -> TrainingRun:
    return TrainingRun(solver, solver.trainer(problem, seed), problem, tasks, seed, path)


@cache
def trained(solver: TrainingSolver) -> TrainedNominal:
    nominal = learn(short_pendulum(), solver, seed=3)
    assert isinstance(nominal, TrainedNominal)
    return nominal


def with_history(**columns: Any) -> TrainedNominal:
    """A nominal whose training is made up."""
    share = np.linspace(0.1, 1.0, 10)
    made = {
        "seconds": 500.0 * share,
        "num_steps": 2e7 * share,
        "kl": 0.3 / share,
        "worst_kl": 0.9 / share,
        "effective_share": 0.8 * share,
        "residual": 0.1 / share,
    }
    history = np.stack([np.broadcast_to(x, 10) for x in (made | columns).values()], axis=1)
    return TrainedNominal(short_pendulum(), PPO(), lambda *_: jnp.zeros(5), history)


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


class TestPlot:
    @pytest.mark.parametrize("suffix", ["png", "svg"])
    def test_is_written(self, tmp_path: Path, suffix: str) -> None:
        path = tmp_path / "new" / f"a.{suffix}"
        with_history().plot_training(path)
        assert path.stat().st_size > 10_000
        if suffix == "png":
            assert imread(path).std() > 0.05

    def test_shows_the_history(self) -> None:
        nominal = with_history()
        figure = plot_training(nominal)
        kl, share, residual = figure.axes
        assert [axes.get_ylabel() for axes in figure.axes] == [
            "KL [nats]",
            "ESS / N [%]",
            "residual [nats]",
        ]
        assert (kl.get_yscale(), share.get_yscale(), residual.get_yscale()) == (
            "log",
            "linear",
            "log",
        )
        assert residual.get_xlabel() == "time [min]"
        lines = {line.get_label(): line for line in kl.lines}
        history = Progress(*nominal.history.T)
        for line, values in (
            (lines["median"], history.kl),
            (lines["worst task"], history.worst_kl),
            (share.lines[0], 100 * history.effective_share),
            (residual.lines[0], history.residual),
        ):
            np.testing.assert_allclose(np.asarray(line.get_xdata()), history.seconds / 60)
            np.testing.assert_allclose(np.asarray(line.get_ydata()), values)
        assert lines["median"].get_linestyle() != lines["worst task"].get_linestyle()
        title = figure.texts[0].get_text().replace("\xa0", " ")
        assert title == "ppo after 8.33 min, 20 million steps: KL 0.30 nats, ESS 80 %"

    def test_marks_steps_where_time_had_come_to_them(self) -> None:
        seconds = 500.0 * np.linspace(0.1, 1.0, 10) ** 2
        figure = plot_training(with_history(seconds=seconds))
        figure.draw_without_rendering()
        (top,) = figure.axes[0].child_axes
        assert top.get_xlabel() == "environment steps [millions]"
        marked = [(float(x.get_text()), x.get_position()[0]) for x in top.get_xticklabels()]
        assert len(marked) >= 4
        millions, minutes = np.transpose(marked)
        expected = np.interp(millions, 20.0 * np.linspace(0.1, 1.0, 10), seconds / 60)
        np.testing.assert_allclose(minutes, expected)

    def test_of_short_trainings_is_in_seconds(self) -> None:
        figure = plot_training(with_history(seconds=np.arange(1.0, 11.0)))
        assert figure.axes[-1].get_xlabel() == "time [s]"

    @pytest.mark.parametrize(
        "columns",
        [{"kl": np.inf, "worst_kl": np.inf, "effective_share": 0.0}, {"kl": -1e-9, "worst_kl": 0}],
        ids=["all-forbidden", "no-divergence"],
    )
    def test_of_what_a_logarithm_cannot_show(self, columns: dict, tmp_path: Path) -> None:
        figure = plot_training(with_history(**columns), tmp_path / "a.png")
        said = " ".join(text.get_text() for text in figure.texts).replace("\xa0", " ")
        assert (FORBIDDEN in said) == np.isinf(columns["kl"])

    def test_nothing_overlaps(self) -> None:
        figure = plot_training(with_history())
        figure.draw_without_rendering()
        renderer = figure.canvas.get_renderer()  # pyright: ignore[reportAttributeAccessIssue]
        boxes = [axes.get_tightbbox(renderer) for axes in figure.axes]
        boxes += [figure.legends[0].get_window_extent(renderer)]
        boxes += [text.get_window_extent(renderer) for text in figure.texts]
        for k, box in enumerate(boxes):
            assert box is not None
            assert box.y0 >= 0
            assert box.x1 <= figure.bbox.width
            assert not any(
                box.shrunk(0.999, 0.999).overlaps(other) for other in boxes[k + 1 :] if other
            )


@pytest.fixture
def brief(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str | Path, ...]:
    """Arguments for training briefly into a folder, with readings that take no time."""
    monkeypatch.setattr(Probe, "read", lambda self, policies: READ)
    solver = "ppo?num_steps=64&num_lanes=8&segment=1&width=4&num_minibatches=1"
    return "--work", tmp_path, "--solver", solver


class TestCommand:
    def test_learn_writes_a_picture(
        self, robot: str, run: Run, tmp_path: Path, brief: tuple[str | Path, ...]
    ) -> None:
        status, _, said = run("learn", robot, *brief)
        assert status == 0
        (picture,) = tmp_path.glob("*.training.png")
        (nominal,) = tmp_path.glob("*.nominal")
        assert picture.name.removesuffix(".training.png") == nominal.name.removesuffix(".nominal")
        assert f"how training went: {picture}" in said

    def test_infer_draws_what_it_trains_and_says_where_it_goes_on(
        self,
        robot: str,
        run: Run,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        brief: tuple[str | Path, ...],
    ) -> None:
        arguments = (robot, *brief, "--samples", 200)
        save = Checkpoint.save

        def save_and_stop(self: Checkpoint, arrays: dict[str, np.ndarray]) -> None:
            save(self, arrays)
            raise KeyboardInterrupt

        monkeypatch.setattr(Checkpoint, "save", save_and_stop)
        status, _, said = run("infer", *arguments)
        assert status == 130
        assert "going on from" not in said
        monkeypatch.setattr(Checkpoint, "save", save)
        status, _, said = run("infer", *arguments)
        assert status == 0
        assert re.search(r"going on from .*\.checkpoint", said)
        (picture,) = tmp_path.glob("*.training.png")
        assert f"how training went: {picture}" in said

    def test_nothing_is_drawn_where_nothing_is_trained(
        self, robot: str, run: Run, tmp_path: Path
    ) -> None:
        work = tmp_path / "work"
        status, _, said = run("learn", robot, "--work", work, "--solver", "grid?num_points=9")
        assert status == 0
        assert "how training went" not in said
        assert not list(work.glob("*.png"))


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
        with pytest.warns(RuntimeWarning, match=r"diverged: .* 9 nats .* least, 0\.5 .* after 2 c"):
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
