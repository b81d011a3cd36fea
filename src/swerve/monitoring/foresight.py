"""Estimate how likely each hypothesis is avoided from here on, by a small network in NumPy.

    log P_0(avoid c after t | s_t = s, t, goal) = -log(1 + exp(-z_c(s, t, goal)))

for all hypotheses c at once. The inputs x of the network are: sines, at several frequencies, of the
state and of its difference to the goal, both in units of the bounds; the rates at which the state
would have to change to reach the goal in time; and the time to go. The layers are

    z = W_L tanh(... tanh(W_1 x + b_1) ...) + b_L.

The probability includes the present state: a state inside a hypothesis has entered the hypothesis.

Shapes: K tasks, H hypotheses, T steps, n state dimensions, g goal dimensions, F inputs, ... any
batch dimensions.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from swerve.base import schema, store
from swerve.base.space import TWO_PI, StateSpace
from swerve.monitoring.schema import ForesightData, read_goals, read_layers
from swerve.problem.record import ProblemRecord

if TYPE_CHECKING:
    from swerve.problem.problem import Problem

KIND = "swerve-foresight"
VERSION = 2
HARMONICS = 4  # frequencies of the sines of each state
SOON = 0.03  # share of the horizon: least time to go that the inputs resolve
RUSH = (0.3, 2.0)  # extents per horizon: a slow and a fast rate of change, at which tanh bends
NUM_TIMES = 4  # inputs that depend on the time alone
SAME_GOAL = 1e-3  # in units of the goals' scale: closer goals are the same goal
WIDTH = 128  # units of each of the two hidden layers
MANY = 1000  # hypotheses: with more, a layer of RANK units before the last saves time
RANK = 32  # units of the layer before the last, see MANY


class Ahead(Protocol):
    """A function: the log-probabilities of avoiding each hypothesis from a state and step on."""

    def __call__(self, state: np.ndarray, step: int) -> np.ndarray:
        """Return log P_0(avoid c from here on) [H], nats, for a state [n] at a step."""
        ...


class Foreseer(Protocol):
    """A source of `Ahead` for each goal: a `Foresight`, or `Rollouts` of the nominal policy."""

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the problem that the foresight belongs to."""
        ...

    def towards(self, goal: np.ndarray) -> Ahead:
        """Return the `Ahead` for a goal [g]."""
        ...


@dataclass(frozen=True, eq=False)
class Inputs:
    """The network's inputs: a function of state, time and goal that is plain data.

    Attributes:
      space: names, angles and bounds of the states.
      goal_is_state: whether goals are states; then the difference to the goal is an input too.
      goal_centre: [g] centre that is subtracted from goals.
      goal_scale: [g] units of the centred goals.
      num_steps: T.
    """

    space: StateSpace
    goal_is_state: bool
    goal_centre: np.ndarray
    goal_scale: np.ndarray
    num_steps: int

    @property
    def size(self) -> int:
        """F, the number of inputs."""
        rates = len(RUSH) * len(self.space.names) if self.goal_is_state else 0
        return len(self.waves()[2]) + NUM_TIMES + len(self.goal_centre) + rates

    def check(self, record: ProblemRecord) -> None:
        """Raise ValueError where the inputs are not those of a problem."""
        if self.num_steps != record.num_steps:
            raise ValueError(f"{self.num_steps} steps, and the problem has {record.num_steps}")
        if self.goal_is_state and len(record.goal_names) != len(record.space.names):
            raise ValueError("goals are no states in this problem")

    def check_goals(self, goals: np.ndarray) -> None:
        """Raise ValueError where goals [G, g] are too large or too far apart to be told apart."""
        with np.errstate(over="ignore"):
            if not np.isfinite(self.scaled_goal(goals)).all():
                raise ValueError("goals that are no numbers in units of goal_scale")

    def waves(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (S, G, p) of the inputs sin(S s + G goal + p).

        The inputs are harmonics of each state and, where goals are states, of the difference to the
        goal; cosines are sines with a phase of a quarter turn. Where goals are states, the first n
        inputs are the first harmonics of the difference to the goal.
        """
        n, g = len(self.space.names), len(self.goal_centre)
        # half a wave over the extent of a straight state: its two bounds then differ
        pace = np.where(self.space.is_angle, 1.0, 0.5 * TWO_PI / (2.0 * self.space.extent))
        rows = []
        if self.goal_is_state:
            away = np.diag(pace)
            for harmonic in (1.0, 2.0):
                for phase in (0.0, 0.25 * TWO_PI):
                    rows += [(harmonic * away[k], -harmonic * away[k], phase) for k in range(n)]
        centre = np.where(self.space.is_angle, 0.0, self.space.bounds.mean(axis=1))
        for harmonic in range(1, HARMONICS + 1):
            for k in range(n):
                row = harmonic * np.diag(pace)[k]
                turn = -float(row @ centre)
                rows += [(row, np.zeros(g), turn), (row, np.zeros(g), turn + 0.25 * TWO_PI)]
        of_state, of_goal, phase = zip(*rows, strict=True)
        return np.array(of_state), np.array(of_goal).reshape(len(rows), g), np.array(phase)

    def times(self, step: Any) -> Any:
        """Return the inputs of the time [..., NUM_TIMES] at steps [...], NumPy or JAX."""
        xp = step.__array_namespace__()
        to_go = 1.0 - step / self.num_steps
        return xp.stack(
            [
                2.0 * to_go - 1.0,
                xp.sqrt(xp.abs(to_go)),
                xp.exp(-to_go / SOON),
                xp.exp(-to_go / (5.0 * SOON)),
            ],
            axis=-1,
        )

    def scaled_goal(self, goal: Any) -> Any:
        """Return goals [..., g] relative to `goal_centre`, in units of `goal_scale`."""
        return (goal - self.goal_centre) / self.goal_scale

    def haste(self, step: Any) -> Any:
        """Return factors [..., len(RUSH)] that turn distances to the goal into rates of change."""
        xp = step.__array_namespace__()
        soon = 1.0 - step / self.num_steps + SOON
        return xp.stack([1.0 / (soon * rush) for rush in RUSH], axis=-1)

    def __call__(self, state: Any, step: Any, goal: Any) -> Any:
        """Return inputs [..., F] of states [..., n] at steps [...] with goals [..., g]."""
        xp, n = state.__array_namespace__(), len(self.space.names)
        of_state, of_goal, phase = self.waves()
        waves = xp.sin(state @ of_state.T + goal @ of_goal.T + phase)
        parts = [waves, self.times(step), self.scaled_goal(goal)]
        if self.goal_is_state:
            haste = self.haste(step)
            parts += [xp.tanh(waves[..., :n] * haste[..., k, None]) for k in range(len(RUSH))]
        return xp.concatenate(parts, axis=-1)


@dataclass(frozen=True, eq=False)
class Foresight:
    """The probability of avoiding each hypothesis from any state and time on; see `foresee`.

    Attributes:
      fingerprint: fingerprint of the problem for which the network was learned.
      learned_from: digest of the evidence to which the network was fitted at the starts of tasks.
      inputs: inputs of the network.
      goals: [G, g] goals for which the network was learned.
      weights: weights [out, in] of each layer.
      biases: biases [out] of each layer.
    """

    fingerprint: str
    learned_from: str
    inputs: Inputs
    goals: np.ndarray
    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]

    def __repr__(self) -> str:
        """Return the number of goals and the sizes of the layers, in one line."""
        sizes = ", ".join(str(len(bias)) for bias in self.biases)
        return f"<Foresight of {len(self.goals)} goals, layers of {sizes}>"

    def knows(self, goal: np.ndarray) -> bool:
        """Return whether the network was learned for a goal [g]."""
        if not len(goal):
            return True
        away = np.abs(self.inputs.scaled_goal(self.goals) - self.inputs.scaled_goal(goal))
        return bool((away.max(axis=1) <= SAME_GOAL).any())

    def log_avoid(self, state: np.ndarray, step: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Return log P_0(avoid c from here on) [..., H], nats.

        Args:
          state: [..., n] states.
          step: [...] steps from 0 to T, or one step for all states.
          goal: [..., g] goals, or one goal for all states.
        """
        state, goal = np.asarray(state, float), np.asarray(goal, float)
        step = np.broadcast_to(np.asarray(step, float), state.shape[:-1])
        x = self.inputs(state, step, np.broadcast_to(goal, (*step.shape, goal.shape[-1])))
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = np.tanh(x @ weight.T + bias)
        output = x @ self.weights[-1].T + self.biases[-1]
        return np.minimum(output, 0.0) - np.log1p(np.exp(-np.abs(output)))

    def towards(self, goal: np.ndarray) -> Ahead:
        """Return the `Ahead` for one goal [g]; each of its calls takes microseconds.

        Raises:
          ValueError: if the network was not learned for this goal.
        """
        goal = np.asarray(goal, float)
        if not self.knows(goal):
            raise ValueError(
                f"foresight: learned for {len(self.goals)} goals, and {goal.tolist()} is none of "
                "them: sample this task too, and learn again with swerve.foresee"
            )
        return _Towards(self, goal)

    def save(self, path: str | Path) -> None:
        """Write the foresight to one file, atomically."""
        inputs = self.inputs
        header = {
            "problem": self.fingerprint,
            "evidence": self.learned_from,
            "space": inputs.space.to_json(),
            "goal_is_state": inputs.goal_is_state,
            "num_steps": inputs.num_steps,
            "num_layers": len(self.weights),
        }
        arrays = {
            "goals": self.goals,
            "goal_centre": inputs.goal_centre,
            "goal_scale": inputs.goal_scale,
        }
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            arrays |= {f"weight/{k}": weight, f"bias/{k}": bias}
        store.write(path, KIND, VERSION, header, arrays)

    @classmethod
    def load(cls, path: str | Path, problem: Problem | ProblemRecord) -> Foresight:
        """Read a foresight that `save` wrote, and check that it belongs to a problem.

        Raises:
          store.StoreError: if the file is cut short, altered, of another kind, version or problem,
            or holds what no foresight holds.
        """
        record = problem if isinstance(problem, ProblemRecord) else problem.record
        with store.open_file(path, KIND, VERSION) as stored:
            header = schema.checked(path, stored.header, ForesightData)
            if header.problem != record.fingerprint:
                raise store.StoreError(
                    path,
                    f"holds the foresight of another problem, not of {record.summary}",
                    "learn it again for this problem, into another file",
                )
            lengths = {"n": len(record.space.names), "g": len(record.goal_names)}
            goals, centre, scale = read_goals(stored, lengths)
            with schema.contents(path):
                space = StateSpace.from_json(header.space)
                if space.to_json() != record.space.to_json():
                    raise ValueError("the states are not those of the problem")
                inputs = Inputs(space, header.goal_is_state, centre, scale, header.num_steps)
                inputs.check(record)
                inputs.check_goals(goals)
            sizes = inputs.size, len(record.hypotheses)
            layers = read_layers(stored, *sizes, header.num_layers)
            return cls(header.problem, header.evidence, inputs, goals, *layers)


def hidden_sizes(num_hypotheses: int) -> tuple[int, ...]:
    """Return the widths of the layers before the last layer."""
    return (WIDTH, WIDTH) if num_hypotheses <= MANY else (WIDTH, WIDTH, RANK)


class _Towards:
    """The network for one goal, evaluated for one state at a time, in buffers made once.

    Inputs that depend on time and goal alone are computed beforehand, for every step.
    """

    def __init__(self, foresight: Foresight, goal: np.ndarray) -> None:
        self._made_of = foresight, goal
        inputs, n = foresight.inputs, len(foresight.inputs.space.names)
        of_state, of_goal, phase = inputs.waves()
        self._of_state, self._phase = of_state, of_goal @ goal + phase
        steps = np.arange(inputs.num_steps + 1.0)
        first, *others = foresight.weights
        num_waves, num_still = len(phase), NUM_TIMES + len(goal)
        still = np.concatenate(
            [inputs.times(steps), np.tile(inputs.scaled_goal(goal), (len(steps), 1))], axis=1
        )
        of_waves, of_still, of_rates = np.split(first, [num_waves, num_waves + num_still], axis=1)
        self._first = np.ascontiguousarray(np.hstack([of_waves, of_rates]), np.float32)
        self._table = (still @ of_still.T + foresight.biases[0]).astype(np.float32)
        self._haste = np.repeat(inputs.haste(steps), n, axis=1).astype(np.float32)
        self._others = [np.ascontiguousarray(weight, np.float32) for weight in others]
        self._biases = [bias.astype(np.float32) for bias in foresight.biases[1:]]
        self._angles = np.empty(num_waves)
        self._x = np.empty(self._first.shape[1], np.float32)
        self._waves, self._rates = self._x[:num_waves], self._x[num_waves:]
        self._away = None
        if inputs.goal_is_state:
            self._away = np.tile(np.arange(n), len(RUSH))
        self._layers = [np.empty(len(weight), np.float32) for weight in foresight.weights]

    def __reduce__(self) -> tuple[Any, ...]:
        """Make it anew on the other side: some buffers are parts of others, and must stay so."""
        return type(self), self._made_of

    def __call__(self, state: np.ndarray, step: int) -> np.ndarray:
        """Return log P_0(avoid c from here on) [H], nats; the next call overwrites this array."""
        np.dot(self._of_state, state, out=self._angles)
        np.add(self._angles, self._phase, out=self._angles)
        np.sin(self._angles, out=self._waves, casting="same_kind")
        if self._away is not None:
            np.take(self._waves, self._away, out=self._rates, mode="clip")
            np.multiply(self._rates, self._haste[step], out=self._rates)
            np.tanh(self._rates, out=self._rates)
        value = np.dot(self._first, self._x, out=self._layers[0])
        np.add(value, self._table[step], out=value)
        for weight, bias, out in zip(self._others, self._biases, self._layers[1:], strict=True):
            np.tanh(value, out=value)
            value = np.dot(weight, value, out=out)
            np.add(value, bias, out=value)
        return _log_sigmoid(value)


def _log_sigmoid(value: np.ndarray) -> np.ndarray:
    """Return -log(1 + exp(-z)) of values z, written over the values."""
    smallest = np.abs(value)
    np.negative(smallest, out=smallest)
    np.exp(smallest, out=smallest)
    np.add(smallest, 1.0, out=smallest)
    np.log(smallest, out=smallest)
    np.minimum(value, 0.0, out=value)
    return np.subtract(value, smallest, out=value)
