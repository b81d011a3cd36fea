"""Tabular MDPs made of arrays, the gridworld, and the tabular solver on them."""

from __future__ import annotations

import itertools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse
from support.reference import short_cart

import swerve
from swerve import ActionBox, Box, Gridworld, Problem, Task, infer, learn, sample, tabular
from swerve.problem.tasks import draw_tasks
from swerve.solvers.exact.tabular import TableNominal
from swerve.systems.gridworld import MOVES, cell_box, gridworld, move_box

RING = np.array([[1, 2], [2, 3], [3, 0], [0, -1]])  # one or two on; the last offers one alone
START = Task(np.array([0.0]), np.zeros(0))


def solve(problem: Problem) -> TableNominal:
    nominal = learn(problem, "tabular")
    assert isinstance(nominal, TableNominal)
    return nominal


class TestTabular:
    def test_sums_over_every_path(self) -> None:
        """By hand: 3 steps from state 0 of the ring, in nats."""
        mdp = tabular(RING, [[-1.0, -2.0]] * 4, num_steps=3)
        problem = Problem(mdp, [Box(state=(2.5, 3.5)), ActionBox(action=(0.5, 1.5))], beta=0.5)
        paths = []
        for actions in itertools.product((0, 1), repeat=3):
            states = [0]
            for action in actions:
                states.append(int(RING[states[-1], action]))
                if states[-1] < 0:
                    break
            else:
                weight = math.exp(0.5 * (-3.0 - sum(actions))) / 8.0
                paths.append((weight, 3 in states, 1 in actions))
        total = sum(weight for weight, *_ in paths)
        evidence = sample(solve(problem), START)
        assert evidence.log_partition[0] == pytest.approx(math.log(total), abs=1e-12)
        for h in (1, 2):
            avoiding = sum(path[0] for path in paths if not path[h])
            share = 1.0 - evidence.violation_probability[0, h - 1]
            assert share == pytest.approx(avoiding / total, abs=1e-12)
            assert 0.05 < share < 0.95

    @pytest.mark.parametrize("form", ["dense", "sparse"])
    def test_matrices_are_the_same_as_successors(self, form: str) -> None:
        matrices = np.zeros((2, 4, 4))
        for state, action in np.argwhere(RING >= 0):
            matrices[action, state, RING[state, action]] = 1.0
        transitions: Any = matrices
        if form == "sparse":
            transitions = [scipy.sparse.csr_matrix(matrix) for matrix in matrices]
        mdp = tabular(transitions, np.zeros(4), num_steps=2)
        np.testing.assert_array_equal(mdp.successors, RING)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            (
                {"transitions": np.full((2, 4, 4), 0.25)},
                r"transitions\[0, 0\]: .* single successor .* deterministic transitions",
            ),
            ({"transitions": [[1, 4], [0, 0]]}, r"transitions\[0, 1\]: .* from 0 to 1, .* got 4"),
            ({"transitions": [[1, -2], [0, 0]]}, r"transitions\[0, 1\]: .* got -2"),
            ({"transitions": [[0.5, 1.0], [0, 0]]}, r"transitions\[0, 0\]: .* number of a state"),
            ({"transitions": np.zeros((2, 4, 5))}, r"transitions\[0\]: .* square .* outside"),
            ({"transitions": np.zeros(3)}, r"transitions: expected \[S, A\] .* got shape \(3,\)"),
            ({"rewards": np.zeros(3)}, r"rewards: expected shape \(4, 2\), got \(3,\)"),
            ({"rewards": np.full((4, 2), np.inf)}, r"rewards\[0, 0\]: expected a .* got inf"),
            ({"rewards": np.full(4, np.nan)}, r"rewards\[0, 0\]: expected a number.* got nan"),
            ({"terminal_rewards": [0, 0, np.nan, 0]}, r"terminal_rewards\[2\]: .* got nan"),
            ({"transitions": []}, r"at least one state and one action, got shape \(0,\)"),
            ({"transitions": np.zeros((0, 2), int)}, r"at least one state .* got shape \(0, 2\)"),
            ({"absorbing": [4]}, r"absorbing: expected states from 0 to 3, got \[4\]"),
        ],
    )
    def test_what_is_no_tabular_mdp(self, changes: dict, message: str) -> None:
        arguments = {"transitions": RING, "rewards": np.zeros(4), "num_steps": 3} | changes
        with pytest.raises(ValueError, match=message):
            tabular(**arguments)

    def test_a_goal_that_cannot_be_reached_names_the_task(self) -> None:
        mdp = tabular(RING, np.zeros(4), num_steps=1, terminal_rewards=[-np.inf] * 3 + [0.0])
        nominal = solve(Problem(mdp, [Box(state=(1.5, 2.5))]))
        tasks = [Task(np.array([2.0]), np.zeros(0)), START]
        with pytest.raises(ValueError, match=r"task 1, from \[0.0\] .* log Z_0 = -inf: the goal"):
            sample(nominal, tasks)

    def test_hypotheses_that_forbid_everything_are_struck_out(self) -> None:
        problem = Problem(tabular(RING, np.zeros(4), num_steps=3), [Box(state=(-0.5, 0.5))])
        result = infer(sample(solve(problem), START))
        assert not len(result.ranking)
        assert result.to_json()["struck_out"][0]["impossible"]
        assert any("nobody could do that task and obey" in text for text in result.warnings)

    def test_other_mdps_are_refused(self) -> None:
        with pytest.raises(ValueError, match=r"needs a tabular MDP, .* got Cart: use solver 'disc"):
            learn(short_cart(), "tabular")

    def test_tables_that_would_not_fit_memory_are_refused(self) -> None:
        mdp = Gridworld(width=200, height=200, num_steps=400_000)
        with pytest.raises(ValueError, match=r"40,000 states, 8 actions, 400000 steps .* GiB"):
            learn(Problem(mdp, [cell_box((0, 0))]), "tabular")

    def test_neighbours_in_a_long_row_are_told_apart(self) -> None:
        num = 5000
        row = np.stack([np.minimum(np.arange(num) + step, num - 1) for step in (1, 2)], axis=1)
        nominal = solve(Problem(tabular(row, np.zeros(num), num_steps=2), [Box(state=(3.5, 4.5))]))
        evidence = sample(nominal, Task(np.array([2.0]), np.zeros(0)))
        assert evidence.find(Task(np.array([2.0]), np.zeros(0))) == 0
        assert evidence.find(Task(np.array([3.0]), np.zeros(0))) is None

    def test_sampling_methods_do_not_apply(self) -> None:
        problem = Problem(tabular(RING, np.zeros(4), num_steps=3), [Box(state=(1.5, 2.5))])
        with pytest.raises(ValueError, match="tabular solver gives exact answers"):
            sample(solve(problem), START, method="plain")
        evidence = sample(solve(problem), START)
        assert evidence.is_exact
        assert not evidence.standard_error.any()
        np.testing.assert_allclose(evidence.log_weight, evidence.log_partition[0], atol=1e-5)

    def test_indices_of_sets_are_checked(self) -> None:
        problem = Problem(tabular(RING, np.zeros(4), num_steps=3), [Box(state=(1.5, 2.5))])
        with pytest.raises(ValueError, match=r"avoiding\[1\]: expected indices from 0 to 0, got 1"):
            solve(problem).log_partition(START, [[0], [1]])


class TestGridworld:
    def test_walls_and_edges_offer_no_move(self) -> None:
        world = Gridworld(width=3, height=2, walls=((1, 0),))
        names = list(MOVES)
        offered = {
            cell: {names[a] for a in np.flatnonzero(world.successors[cell[1] * 3 + cell[0]] >= 0)}
            for cell in ((0, 0), (2, 1))
        }
        assert offered == {(0, 0): {"up", "up-right"}, (2, 1): {"left", "down"}}
        up = jnp.array([0.0, 1.0])
        np.testing.assert_array_equal(world.dynamics(jnp.array([2.0, 0.0]), up), [2.0, 1.0])
        edge = jnp.array([2.0, 1.0])
        np.testing.assert_array_equal(world.dynamics(edge, up), edge)
        assert world.reward(edge, up, edge, edge) == -math.inf

    def test_counts_shortest_ways(self) -> None:
        """As many as there are, at a cost so high that nothing longer counts."""
        world = Gridworld(width=3, height=3, num_steps=4, step_reward=-200.0)
        problem = Problem(world, world.hypotheses(), measure="counting", between_states=False)
        far, near = Task(np.zeros(2), np.array([2.0, 1.0])), Task(np.zeros(2), np.array([2.0, 2.0]))
        evidence = sample(solve(problem), [far, near])
        np.testing.assert_allclose(evidence.log_partition, [-400.0 + math.log(2.0), -400.0])
        cells = evidence.violation_probability[:, :9]
        np.testing.assert_allclose(cells[0, [1, 4]], 0.5)  # either before the diagonal move
        assert cells[1, 4] == pytest.approx(1.0)

    def test_hypotheses_are_features_cells_and_moves(self) -> None:
        world = Gridworld(width=2, height=2, cell_features=(("wet", ((0, 0), (1, 0))),))
        names = [constraint.name for constraint in world.hypotheses()]
        assert len(names) == 1 + 4 + 8
        assert names[0] == "wet"
        assert names[2] == cell_box((1, 0)).name
        assert names[5] == move_box("left").name

    def test_cells_outside_are_refused(self) -> None:
        with pytest.raises(ValueError, match=r"walls: cell \(3, 0\) is not in the world of 3 x 2"):
            Gridworld(width=3, height=2, walls=((3, 0),))

    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"width": 2.5}, r"width: expected a whole number >= 1, got 2.5"),
            ({"height": 0}, r"height: expected a whole number >= 1, got 0"),
            ({"step_reward": math.nan}, r"step_reward: expected a number, got nan"),
            ({"walls": (1, 1)}, r"cells as pairs of whole numbers, .* got \(1, 1\)"),
            ({"cell_features": ("wet", ((1, 1),))}, r"names and their cells, .* got \('wet', "),
            ({"cell_features": {"wet": (1, 1)}}, r"cells as pairs of whole numbers, .*\(1, 1\)"),
        ],
    )
    def test_what_is_no_world(self, settings: dict, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            Gridworld(**settings)

    def test_features_are_a_dictionary_or_pairs(self) -> None:
        pairs = (("wet", ((1, 1), (2, 1))),)
        for given in (pairs, {"wet": [[1, 1], (2, 1)]}):
            assert Gridworld(cell_features=given).cell_features == pairs  # pyright: ignore

    def test_its_tasks_are_cells(self) -> None:
        problem = gridworld()
        evidence = swerve.sample(learn(problem, "tabular"), Task(np.zeros(2), np.array([8.0, 0.0])))
        kept = evidence.samples.kept[0]
        np.testing.assert_array_equal(kept, np.round(kept))
        np.testing.assert_array_equal(kept[:, -1], np.tile([8.0, 0.0], (100, 1)))

    def test_there_is_nothing_between_states_that_are_numbers(self) -> None:
        """From 0 straight to 2: state 1 is not entered."""
        row = tabular(np.array([[2], [2], [2]]), np.zeros(3), num_steps=2)
        problem = Problem(row, [Box(state=(0.5, 1.5))])
        assert not problem.between_states
        assert sample(solve(problem), START).violation_probability[0, 0] == 0.0

    def test_walls_are_nobodys_start(self) -> None:
        world = Gridworld(width=3, height=2, walls=((1, 0), (1, 1)), num_steps=9)
        problem = Problem(world, [cell_box((2, 1))], measure="counting", between_states=False)
        drawn = draw_tasks(problem, 40)
        assert set(drawn.start[:, 0]) | set(drawn.goal[:, 0]) == {0.0, 2.0}
        with pytest.raises(ValueError, match="no trajectory is allowed"):
            sample(solve(problem), Task(np.array([1.0, 0.0]), np.array([0.0, 0.0])))

    def test_mirror_images_are_tied(self) -> None:
        world = Gridworld(num_steps=12)
        problem = Problem(world, world.hypotheses(), measure="counting", between_states=False)
        result = infer(sample(solve(problem), Task(np.array([0.0, 4.0]), np.array([8.0, 4.0]))))
        rank = dict(zip(result.ranking.tolist(), result.rank.tolist(), strict=True))
        for x, y in itertools.product(range(9), range(4)):
            assert rank.get(9 * y + x) == rank.get(9 * (8 - y) + x)
