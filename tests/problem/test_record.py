"""Records of problems: JSON and fingerprints."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest
from support.reference import Cart, short_cart, short_pendulum
from support.ships import Rigging, Ship
from support.small_mdps import ANGLES, CELLS, Bare, Height

from swerve import MDP, Box, Pendulum, Predicate, Problem, grid
from swerve.problem.record import ProblemRecord


class Sail(Cart):
    """Every way in which an MDP may hold a parameter."""

    wind: float | jax.Array = 1.0
    crew: int = eqx.field(default=3, static=True)
    rig: str = eqx.field(default="sloop", static=True)
    current: jax.Array = eqx.field(default_factory=lambda: jnp.zeros(3))
    hulls: tuple = (1.0, 2.0)


def pushed(middle: float) -> MDP:
    """Carts of one name whose code is not the same."""

    class Pushed(Cart):
        @property
        def actions(self):
            return jnp.array([[-1.0], [middle], [1.0]])

    return Pushed()


def predicate(name: str, num_points: int = 8) -> Predicate:
    return Predicate(name, lambda states: states[..., 0] > 1.0, num_points)


DIFFERENT = {
    "same": Problem(Sail(), CELLS),
    "wind": Problem(Sail(wind=1.0 + 1e-15), CELLS),
    "wind as an array": Problem(Sail(wind=jnp.array(2.0)), CELLS),
    "crew": Problem(Sail(crew=4), CELLS),
    "rig": Problem(Sail(rig="cat"), CELLS),
    "current": Problem(Sail(current=jnp.array([0.0, 1e-7, 0.0])), CELLS),
    "shape of current": Problem(Sail(current=jnp.zeros((3, 1))), CELLS),
    "hulls": Problem(Sail(hulls=(1.0, 3.0)), CELLS),
    "dt": Problem(Sail(dt=0.25), CELLS),
    "num_steps": Problem(Sail(num_steps=8), CELLS),
    "class": Problem(Cart(), CELLS),
    "actions": Problem(pushed(0.5), CELLS),
    "other actions": Problem(pushed(0.25), CELLS),
    "beta": Problem(Sail(), CELLS, beta=1.0 + 1e-15),
    "measure": Problem(Sail(), CELLS, measure="counting"),
    "between_states": Problem(Sail(), CELLS, between_states=False),
    "hypotheses": Problem(Sail(), grid(x=(-1.5, 1.5, 6), v=(-2.0, 2.0, 5))),
    "order of axes": Problem(Sail(), grid(v=(-2.0, 2.0, 4), x=(-1.5, 1.5, 6))),
    "boxes": Problem(Sail(), [CELLS.constraint(k) for k in range(len(CELLS))]),
    "predicate": Problem(Sail(), [predicate("p")]),
    "another predicate": Problem(Sail(), [predicate("q")]),
    "points of a predicate": Problem(Sail(), [predicate("p", 9)]),
    "known": Problem(Sail(), CELLS, known=[Box(x=(0.0, 0.1))]),
    "another known": Problem(Sail(), CELLS, known=[Box(x=(0.0, 0.2))]),
    "two known": Problem(Sail(), CELLS, known=[Box(x=(0.0, 0.1)), Box(x=(0.0, 0.2))]),
}


class TestRecord:
    @pytest.mark.parametrize(
        "problem",
        [
            Problem(Pendulum(max_torque=10.0), ANGLES, beta=0.67),
            Problem(Height(), [Box(theta=(6.0, 7.0))], known=[Box(speed=(2.5, 3.0))]),
            short_cart(measure="counting", between_states=False, known=[predicate("p")]),
        ],
    )
    def test_round_trip(self, problem: Problem) -> None:
        record = problem.record
        text = json.dumps(record.to_json(), allow_nan=False)
        back = ProblemRecord.from_json(json.loads(text))
        assert json.dumps(back.to_json()) == text
        assert back.fingerprint == record.fingerprint
        assert back.summary == record.summary
        for field in dataclasses.fields(record):
            value, again = getattr(record, field.name), getattr(back, field.name)
            assert type(again) is type(value)
            if isinstance(value, int | float | str | bool):
                assert again == value
        assert back.goal_names == problem.mdp.goal_names
        assert back.action_names == problem.mdp.action_names

    def test_fields(self) -> None:
        record = Problem(Height(push=2), ANGLES, beta=2).record
        assert record.name == "Height(push=2)"
        assert record.goal_names == ("height",)
        assert not record.goal_is_last_state
        assert Problem(Bare(), ANGLES).record.goal_is_last_state
        assert (record.num_actions, record.num_steps, record.dt) == (3, 4, 0.5)
        assert (record.beta, record.measure, record.between_states) == (2.0, "uniform", True)
        assert record.summary == (
            "Height(push=2), beta 2, uniform measure, 4 hypotheses judged at states and segments "
            "between them"
        )
        walled = Problem(Bare(), ANGLES, known=[Box(speed=(2.0, 3.0))], between_states=False)
        assert walled.record.summary.endswith("judged at states alone, known: speed [2, 3)")

    def test_a_fingerprint_is_the_same_for_the_same_problem(self) -> None:
        again = Problem(Sail(), grid(x=(-1.5, 1.5, 6), v=(-2, 2, 4)), beta=1)
        assert again.record.fingerprint == DIFFERENT["same"].record.fingerprint
        assert short_pendulum().record.fingerprint == short_pendulum().record.fingerprint

    def test_a_fingerprint_depends_on_everything(self) -> None:
        prints = {name: problem.record.fingerprint for name, problem in DIFFERENT.items()}
        same: dict[str, list[str]] = {}
        for name, fingerprint in prints.items():
            same.setdefault(fingerprint, []).append(name)
        assert [names for names in same.values() if len(names) > 1] == []


def test_a_fingerprint_depends_on_static_fields_of_any_kind() -> None:
    cells = grid(x=(-1.5, 1.5, 6))
    ships = [Ship(), Ship(buoys=(1.0, 3.0)), Ship(rigging=Rigging("cat"))]
    assert len({Problem(ship, cells).record.fingerprint for ship in ships}) == 3


def test_a_fingerprint_does_not_depend_on_addresses() -> None:
    """A field that holds a function: the same problem in two processes."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); import swerve, support.ships;"
        "junk = [object() for _ in range(int(sys.argv[2]))];"
        "wind = eval('lambda x: x', {'__name__': 'm'});"
        "problem = swerve.Problem(support.ships.Ship(wind=wind), swerve.grid(x=(0, 1, 2)));"
        "print(problem.record.fingerprint)"
    )
    folder = str(Path(__file__).parents[1])
    prints = {
        subprocess.run(
            [sys.executable, "-c", code, folder, num], capture_output=True, text=True, check=True
        ).stdout
        for num in ("0", "100000")
    }
    assert len(prints) == 1
