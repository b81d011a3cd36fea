"""The motion of a problem is learned with its evidence, and kept with it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from support.contacts import Ball, Wall, Wrap, runs
from support.reference import PENDULUM_TASK, short_pendulum
from support.synthetic import make_evidence

import swerve
from swerve.evidence.evidence import Evidence
from swerve.monitoring.flags import StateChecks
from swerve.sampling.motion import motion_of


class Broken(swerve.Pendulum):
    """Its dynamics are not finite for a part of the states that its bounds allow."""

    def dynamics(self, state, action):
        return super().dynamics(state, action) + jnp.where(state[0] > 4.0, jnp.nan, 0.0)


class Lost(Broken):
    """Its dynamics are finite for slow states alone."""

    def dynamics(self, state, action):
        return super().dynamics(state, action) + jnp.where(jnp.abs(state[1]) > 3.0, jnp.nan, 0.0)


def test_evidence_of_all_kinds_holds_the_motion(tmp_path: Path) -> None:
    problem = short_pendulum()
    for solver in ("enumeration", "grid?num_points=20"):
        evidence = swerve.sample(swerve.learn(problem, solver), PENDULUM_TASK, 50)
        motion = evidence.motion
        assert motion is not None
        assert motion is motion_of(problem)  # learned once
        assert motion.reach[1] > 1.0  # torques up to 3
        assert evidence.select([0]).motion is motion
        older = dataclasses.replace(evidence, motion=None)
        assert older.joined(evidence).motion is motion
        assert evidence.is_exact or evidence.at_beta(0.06).motion is motion
        evidence.save(tmp_path / "motion.evidence")
        read = Evidence.load(tmp_path / "motion.evidence").motion
        assert read is not None
        for stored, known in zip(read, motion, strict=True):
            np.testing.assert_array_equal(stored, known)


class Drifting(swerve.Pendulum):
    """A wind turns it: code that no digest knows."""

    wind: Callable = None  # pyright: ignore

    def dynamics(self, state, action):
        return super().dynamics(state, action) + self.dt * self.wind(state)


def test_code_that_differs_has_another_motion() -> None:
    cells = swerve.grid(omega=(-1.0, 1.0, 2))
    winds = [partial(jnp.full_like, fill_value=speed) for speed in (1.0, -5.0)]
    found = [motion_of(swerve.Problem(Drifting(wind=wind), cells)) for wind in winds]
    forms = [motion.forms for motion in found if motion is not None]
    assert np.abs(forms[0] - forms[1]).max() > 1.0


def test_problems_of_one_mdp_share_its_motion() -> None:
    """As those that are resolved, each with another known constraint."""
    problem = short_pendulum()
    motion = motion_of(problem)
    narrower = dataclasses.replace(problem, known=[swerve.Box(omega=(5.0, 6.0))])
    assert motion_of(narrower) is motion
    lost = swerve.Problem(Lost(), problem.hypotheses)
    assert motion_of(lost) is None
    other = motion_of(swerve.Problem(swerve.Pendulum(max_torque=7.0), problem.hypotheses))
    assert motion is not None
    assert other is not None
    assert other.reach[1] > 1.5 * motion.reach[1]


def test_moves_without_a_clock_have_no_motion() -> None:
    floor = swerve.Problem(swerve.Walker(), swerve.grid(x=(-1.0, 1.0, 2)))
    assert motion_of(floor) is None
    assert not floor.record.is_timed
    world = swerve.Gridworld(width=3, height=3)
    assert motion_of(swerve.Problem(world, swerve.grid(x=(-0.5, 2.5, 3)))) is None


def test_states_for_which_the_dynamics_are_not_finite_are_left_out() -> None:
    cells = swerve.grid(theta=(0.0, 6.0, 3))
    known = motion_of(swerve.Problem(Broken(max_torque=3.0), cells))
    assert known is not None
    assert np.isfinite(known.forms).all()
    assert motion_of(swerve.Problem(Lost(max_torque=3.0), cells)) is None


@cache
def evidence_of(system: type[Ball]) -> Evidence:
    """Evidence of a system with contacts for its start; any speed is usual in it."""
    problem = swerve.Problem(system(), swerve.grid(y=(0.0, 10.0, 5)))
    tasks = swerve.Task(*2 * (np.array([system.start]),))
    return dataclasses.replace(
        make_evidence(problem.record, tasks=tasks), motion=motion_of(problem)
    )


@pytest.mark.parametrize("system", [Ball, Wall, Wrap])
def test_a_run_of_the_model_itself_is_never_impossible(system: type[Ball]) -> None:
    """Bounces, walls and jumps are rare among steps, and may be most of the motion of a run."""
    evidence, items = evidence_of(system), runs(system(), 8)
    few = [
        dataclasses.replace(item, states=item.states[::4], times=item.times[::4])  # pyright: ignore
        for item in items
    ]
    for group in (items, few, [dataclasses.replace(item, times=None) for item in items]):
        assert not [w for w in swerve.infer(evidence, group).warnings if "dynamics cannot" in w]
    for item in items:
        checks, rows = StateChecks(evidence, 0), item.states.tolist()
        times = (system.dt * np.arange(len(rows))).tolist()
        checks.of_first(rows[0], times[0])
        for k in range(1, len(rows)):
            flags = checks.of_next(rows[k], times[k], rows[k - 1], times[k - 1])
            assert not {"against the dynamics", "unreachable"} & set(flags)


@pytest.mark.parametrize("system", [Ball, Wall])
def test_what_contacts_do_not_touch_is_still_judged(system: type[Ball]) -> None:
    """The position follows from the speed, whatever becomes of the speed."""
    item = runs(system(), 1)[0]
    states = np.vstack([item.states[:1], item.states[1:] * [1.0, -1.0]])
    wrong = dataclasses.replace(item, states=states)
    warnings = swerve.infer(evidence_of(system), [wrong]).warnings
    assert [w for w in warnings if "y changes by" in w and "v reversed" in w]
