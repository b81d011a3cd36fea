"""A demonstration is held against the dynamics while it lasts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.motions import DT, SPACE, cart_motion, cart_record, drive
from support.synthetic import make_evidence

from swerve.base.space import Task
from swerve.demonstrations.demonstration import Demonstration
from swerve.monitoring.flags import StateChecks
from swerve.trust.motion_watch import MotionWatch

AGAINST, UNREACHABLE = "against the dynamics", "unreachable"


def flags(item: Demonstration) -> list[set[str]]:
    """The flags of each state after the first."""
    evidence = make_evidence(cart_record(), tasks=Task(*(x[None] for x in drive().task)))
    checks = StateChecks(dataclasses.replace(evidence, motion=cart_motion()), 0)
    states = item.states.tolist()
    times = [DT * k for k in range(len(states))] if item.times is None else item.times.tolist()
    checks.of_first(states[0], times[0])
    return [
        set(checks.of_next(states[k], times[k], states[k - 1], times[k - 1]))
        for k in range(1, len(states))
    ]


def seen(item: Demonstration) -> set[str]:
    return set().union(*flags(item))


def of_states(item: Demonstration, states: np.ndarray) -> Demonstration:
    return dataclasses.replace(item, states=states)


@pytest.mark.parametrize("rate", [0.5, 1.0, 5.0])
def test_what_the_dynamics_allow_is_not_flagged(rate: float) -> None:
    generator = np.random.default_rng(1)
    for seed in range(5):
        item = drive(rate, seed)
        assert not seen(item) - {"gap"}
        noise = 0.003 * SPACE.extent * generator.standard_normal(item.states.shape)
        assert not seen(of_states(item, item.states + noise)) - {"gap"}


@pytest.mark.parametrize(
    "change",
    [lambda s: s * [1, -1], lambda s: s * [-1, 1], lambda s: np.vstack([s[:1], s[1:, ::-1]])],
)
@pytest.mark.parametrize("rate", [1.0, 5.0])
def test_a_wrong_sign_and_swapped_columns_are_flagged_early(change, rate: float) -> None:
    found = flags(of_states(drive(rate), change(drive(rate).states)))
    first = min(k for k, names in enumerate(found) if AGAINST in names)
    assert first < 0.6 * len(found)


def test_a_wrong_sign_is_flagged_on_a_short_way() -> None:
    """Over a seventh of the bounds, in twenty steps."""
    times = np.linspace(0.0, 1.0, 21)
    way = np.stack([0.9 * times - 0.6, np.full(21, 0.9)], axis=1)
    item = Demonstration("short", way, Task(way[0], way[-1]), times)
    assert AGAINST not in seen(item)
    assert AGAINST in seen(of_states(item, way * [1, -1]))


@pytest.mark.parametrize("place", [3, 6, 17])
def test_a_glitch_on_a_short_way_is_out_of_reach_alone(place: int) -> None:
    times = np.linspace(0.0, 1.0, 21)
    way = np.stack([0.9 * times - 0.6, np.full(21, 0.9)], axis=1)
    way[place, 0] += 0.9
    assert seen(Demonstration("short", way, Task(way[0], way[-1]), times)) == {UNREACHABLE}


@pytest.mark.parametrize("factor", [0.1, 0.5, 2.0, 10.0])
def test_another_rate_is_flagged(factor: float) -> None:
    item = drive(5.0)
    assert item.times is not None
    assert AGAINST in seen(dataclasses.replace(item, times=factor * item.times))


def test_one_wrong_row_is_out_of_reach_and_no_more() -> None:
    item = drive(5.0)
    item.states[150, 0] += 0.6
    found = flags(item)
    assert [k for k, names in enumerate(found) if UNREACHABLE in names] == [149, 150]
    assert AGAINST not in set().union(*found)


def test_another_state_at_the_same_time_is_where_the_next_step_begins() -> None:
    evidence = make_evidence(cart_record(), tasks=Task(*(x[None] for x in drive().task)))
    checks = StateChecks(dataclasses.replace(evidence, motion=cart_motion()), 0)
    checks.of_first([0.0, 0.0], 0.0)
    assert checks.of_next([0.0, 3.0], 0.0, [0.0, 0.0], 0.0) == ("another state at the same time",)
    assert checks.of_next([0.3, 3.0], 0.1, [0.0, 3.0], 0.0) == ("gap",)


def test_rates_are_those_of_a_finished_demonstration() -> None:
    motion, states = cart_motion(), drive().states
    watch = MotionWatch(motion, SPACE)
    rates = [watch._rates_of(state) for state in states.tolist()]
    np.testing.assert_allclose(rates, motion.rates(states, SPACE), rtol=1e-9, atol=1e-9)
