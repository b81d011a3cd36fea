"""What training leaves behind: its history, a picture of it, and what it says of bad MDPs."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command import Run
from matplotlib.image import imread
from reference import Cart, short_pendulum
from training import Interrupted

from swerve import PPO, Problem, SoftValue, grid, learn, load_nominal, save_nominal, store
from swerve.solvers.checkpoints import Checkpoint
from swerve.solvers.lanes import Lanes, fresh_lanes
from swerve.solvers.nonfinite import check_steps
from swerve.solvers.probe import Probe, Reading
from swerve.solvers.training import Progress, TrainedNominal, TrainingSolver
from swerve.solvers.training import Run as TrainingRun
from swerve.training_plot import FORBIDDEN, plot_training

SOLVERS = {
    "ppo": PPO(num_steps=20_480, num_lanes=16, segment=8, num_minibatches=2, width=8),
    "soft-value": SoftValue(num_steps=8_000, num_lanes=16, segment=8, width=8),
}
READ = Reading(2.0, 5.0, 0.3)
each_solver = pytest.mark.parametrize("solver", SOLVERS.values(), ids=SOLVERS)


def new_run(solver: TrainingSolver, problem: Problem, seed: int, path: Path | None) -> TrainingRun:
    return TrainingRun(solver, solver.trainer(problem, seed), problem, None, seed, path)


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
        monkeypatch.setattr(Probe, "read", lambda self, policy: READ)
        solver, path = PPO(num_steps=1, num_lanes=8, segment=1, width=4), tmp_path / "a.checkpoint"
        run = new_run(solver, short_pendulum(), 0, path)
        assert run.advance() is not None
        assert run.advance() is None
        again = new_run(solver, short_pendulum(), 0, path)
        assert again.history == run.history
        assert again.advance() is None

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


class TestCommand:
    def test_learn_writes_a_picture(
        self, robot: str, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(Probe, "read", lambda self, policy: READ)
        work = tmp_path / "work"
        solver = "ppo?num_steps=1&num_lanes=8&segment=1&width=4"
        status, _, said = run("learn", robot, "--work", work, "--solver", solver)
        assert status == 0
        (picture,) = work.glob("*.training.png")
        (nominal,) = work.glob("*.nominal")
        assert picture.name.removesuffix(".training.png") == nominal.name.removesuffix(".nominal")
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

    @each_solver
    def test_of_the_network_are_divergence(
        self, solver: TrainingSolver, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """What was learned before it is kept; if that is nothing, it is an error."""
        monkeypatch.setattr(Probe, "read", lambda self, policy: READ)
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
