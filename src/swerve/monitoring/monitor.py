"""Inference while it happens: what a demonstration tells, state by state.

A demonstration that has avoided c up to its state s_t has, against no constraint, the
log-likelihood ratio

    log L_t(c) = log P_0(avoid c after t | s_t, t, goal) - log P_0(avoid c | s_0, goal),

whose second term is what the evidence knows (log Z_c / Z_0), and whose first is foreseen. One that
has entered c is ruled out. At its end nothing is left to be avoided, the first term is 0, and the
answer is that of `infer`. With a tolerance eps it is eps + (1 - eps) L_t(c), or eps once c is
entered.

Foresight cannot tell probabilities as small as evidence can. Where the two differ widely at the
start itself, the second term too is foreseen until the end, so that nothing is believed of somebody
who has not moved.

Shapes: H hypotheses, n state dimensions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from swerve.base.arguments import instance, number_or_nan
from swerve.base.space import TWO_PI, Task
from swerve.constraints.base import violates
from swerve.demonstrations.checks import START_TOLERANCE
from swerve.evidence.evidence import Evidence
from swerve.hypotheses.stepwise import stepwise
from swerve.inference import likelihood
from swerve.inference.posterior import Prior, checked_prior, posterior
from swerve.monitoring.foresight import Foreseer
from swerve.problem.problem import ProblemRecord
from swerve.trust.doubts import COARSE, FAST, JITTER, TIME_SLACK

LATE = "late start"
OUTSIDE = "outside the bounds"
UNREACHABLE = "unreachable"
REPEATED = "repeated"
CONFLICTING = "another state at the same time"
GAP = "gap"
OVERTIME = "past the horizon"
SHORT = "cut short"
KNOWN = "in a known constraint"

AGREEMENT = 1.0  # nats between evidence and foresight, at the start


class Belief(NamedTuple):
    """What the states so far tell.

    Attributes:
      struck_out: [H] True where ruled out; with a tolerance entering rules nothing out.
      log_likelihood: [H] ratio against no constraint [nats]; -inf where struck out.
      none: probability that there is no constraint.
      hypotheses: [H] probability of each.
      entered: the hypotheses that the newest state is the first to enter.
      flags: what is odd about the newest state; empty if nothing is.
    """

    struck_out: np.ndarray
    log_likelihood: np.ndarray
    none: float
    hypotheses: np.ndarray
    entered: tuple[int, ...]
    flags: tuple[str, ...]


class Monitor:
    """Infers which constraint one demonstrator obeys, while the demonstration lasts.

    Its memory does not grow. Several demonstrators take a monitor each; arrays that it returns are
    not to be written to.

    Args:
      evidence: what `infer` would rest on.
      task: start and goal of the demonstration, one of those of the evidence.
      foresight: from `swerve.foresee`, or `swerve.Rollouts` of the nominal distribution.
      prior: as for `infer`.
      tolerance: as for `infer`.
      margin: as for `infer`.
      clearance: as for `infer`.

    Raises:
      ValueError: if an argument is of the wrong kind or range, hypotheses are about actions, there
        is no evidence for the task, or the foresight is of another problem or not for its goal.
    """

    def __init__(
        self,
        evidence: Evidence,
        task: Task,
        foresight: Foreseer,
        *,
        prior: Prior = None,
        tolerance: float = 0.0,
        margin: Mapping[str, float] | None = None,
        clearance: float | None = None,
    ) -> None:
        instance(evidence, Evidence, "evidence", "make some with swerve.sample")
        self.evidence = evidence
        problem = evidence.problem
        hypotheses, space = problem.hypotheses, problem.space
        check_hypotheses(problem)
        _check_foresight(problem, foresight)
        self._tolerance = likelihood.checked_tolerance(tolerance)
        self._prior = checked_prior(prior, len(hypotheses))
        number = evidence.match(task)
        self._problem = problem
        self._start = np.asarray(evidence.tasks.start[number], float)
        self._ahead = foresight.towards(evidence.tasks.goal[number])
        self._judged = hypotheses if margin is None else hypotheses.eroded(margin, space)
        self._steps = stepwise(hypotheses, self._judged, space, problem.between_states)
        self._clearance = clearance
        self._entered = np.zeros(len(hypotheses), bool)
        with np.errstate(divide="ignore"):
            log_prior = np.log(self._prior)
        self._log_none, self._log_share = float(log_prior[0]), log_prior[1:].astype(np.float32)
        self._goal = np.asarray(evidence.tasks.goal[number], float)
        # the first call takes longest: not while they move
        self._begin(self._start, evidence.log_ratio[number], self._ahead(self._start, 0))
        limits = space.bounds + [-START_TOLERANCE, START_TOLERANCE] * space.extent[:, None]
        limits[space.is_angle] = -np.inf, np.inf
        self._bounds = limits.tolist()
        self._is_angle = space.is_angle.tolist()
        self._fastest = (FAST * evidence.summary.fastest[number]).tolist()
        self._shortest = float(evidence.summary.shortest[number])
        self._jitter = (JITTER * space.extent).tolist()
        self._near = (START_TOLERANCE * space.unit).tolist()
        self._array = np.empty(len(space.names))
        self._state: list[float] = []
        self._time, self._is_timed = 0.0, False
        self._last: Belief | None = None

    def observe(self, state: Sequence[float] | np.ndarray, time: float | None = None) -> Belief:
        """Take in the next state and return what all states so far tell.

        Args:
          state: [n]; angles may be wrapped or not.
          time: since the task's start [s]; None takes each state to be one step of the model after
            the last, the first being at the start. Either all states have one or none.

        Returns:
          What is believed now, with flags that say what is odd about this state: a first one that
          is not the task's start (what went before is then left open), one outside the bounds or in
          a known constraint, one that cannot be reached from the last in that time, one that comes
          again (which changes nothing) or contradicts the last, a gap of more than a step and a
          half before it, or one later than the model's horizon.

        Raises:
          ValueError: if the state is not n finite numbers, or time is not finite, negative, runs
            backwards, or is there for some states only; then nothing has changed. If nothing that
            the prior allows is left, or the foresight gives NaN; then the state has been taken in.
        """
        values = self._checked(state)
        now, is_first = self._checked_time(time), not self._state
        if self._last is not None and now == self._time and values == self._state:
            return self._last._replace(entered=(), flags=(REPEATED,))
        self._array[:] = values
        flags = self._flags(values, now, is_first)
        last, self._state, self._time, self._last = self._state, values, now, None
        self._is_timed = time is not None
        step = min(round(now / self._problem.dt), self._problem.num_steps)
        is_over = step == self._problem.num_steps  # nothing is left to be avoided
        if is_first and LATE in flags:
            foreseen = np.zeros(len(self._entered)) if is_over else self._ahead(self._array, step)
            self._begin(self._array, foreseen, foreseen)
        new = tuple(
            k for k in self._steps.enter(values) if self._is_counted[k] and not self._entered[k]
        )
        if new:
            self._entered[list(new)] = True
        if self._problem.known and self._is_forbidden(last or values, values):
            flags = (*flags, KNOWN)
        if is_over:
            log_likelihood = -self._log_ratio.astype(np.float32)
        else:
            ahead = self._ahead(self._array, step)
            log_likelihood = np.subtract(ahead, self._base, dtype=np.float32)
        if self._left_out is not None:
            log_likelihood[self._left_out] = 0.0
        self._last = self._belief(log_likelihood, new, flags)
        return self._last

    @property
    def is_new(self) -> bool:
        """Whether no state has come yet."""
        return not self._state

    def finish(self) -> Belief:
        """Return what the demonstration tells if it ends here: what `infer` tells of it.

        It is flagged as cut short where nominal trajectories take longer.

        Raises:
          ValueError: if no state has come yet, or nothing that the prior allows is left.
        """
        if not self._state:
            raise ValueError("finish: no state of the demonstration has come yet")
        value = likelihood.avoiding_term(self._log_ratio, self._tolerance)
        entering = math.log(self._tolerance) if self._tolerance else -math.inf
        value = np.where(self._entered, entering, value)
        value[self._impossible] = -np.inf
        probability = posterior(value, self._prior)
        is_short = self._time < (1.0 - TIME_SLACK) * self._shortest
        return Belief(
            np.isneginf(value),
            value,
            float(probability[0]),
            probability[1:],
            entered=(),
            flags=(SHORT,) if is_short else (),
        )

    def _begin(self, state: np.ndarray, log_ratio: np.ndarray, foreseen: np.ndarray) -> None:
        """Set what is held against prefixes that begin in a state [n], and what against the whole.

        Args:
          state: the first.
          log_ratio: [H] log P(avoid c), nats; -inf where nobody can.
          foreseen: [H] the same, as the foresight has it.
        """
        task = Task(state[None], self._goal[None])
        counted = likelihood.is_counted(self._problem, task, self._clearance, self._judged)[0]
        self._is_counted, self._left_out = counted, None if counted.all() else ~counted
        self._impossible = np.isneginf(log_ratio) & counted
        known = np.where(counted & ~self._impossible, log_ratio.astype(float), 0.0)
        is_far = counted & np.isfinite(foreseen) & (np.abs(foreseen - known) > AGREEMENT)
        self._log_ratio = known
        self._base = np.where(is_far, foreseen, known).astype(np.float32)

    def _belief(
        self, value: np.ndarray, entered: tuple[int, ...], flags: tuple[str, ...]
    ) -> Belief:
        """Return the belief by log-likelihood ratios [H] of what was not entered, nats."""
        struck_out = self._entered | self._impossible
        if self._tolerance:
            value += math.log1p(-self._tolerance)
            value[self._entered] = -np.inf
            np.logaddexp(value, np.float32(math.log(self._tolerance)), out=value)
            struck_out = self._impossible.copy()
        np.copyto(value, -np.inf, where=struck_out)
        joint = value + self._log_share
        largest = max(float(joint.max()), self._log_none)  # NaN if one is
        if math.isnan(largest):
            raise ValueError(
                f"foresight: gave NaN for {self._state} at {self._time:g} s: learn it again, or "
                "mend it"
            )
        if largest == -math.inf:
            raise ValueError(
                "prior: the states so far rule out every hypothesis, and P(no constraint) is 0: "
                "give it some probability, or the monitor a tolerance"
            )
        joint -= np.float32(largest)
        np.exp(joint, out=joint)
        none = math.exp(self._log_none - largest)
        total = none + float(joint.sum())
        joint /= np.float32(total)
        for array in (struck_out, value, joint):
            array.setflags(write=False)
        return Belief(struck_out, value, none / total, joint, entered, flags)

    def _checked(self, state: Sequence[float] | np.ndarray) -> list[float]:
        """Return a state as n floats."""
        names = self._problem.space.names
        try:
            values = [] if isinstance(state, str) else [float(value) for value in state]
        except (TypeError, ValueError, OverflowError):
            values = []
        if len(values) != len(names):
            raise ValueError(
                f"state: expected {len(names)} numbers ({', '.join(names)}), got {state!r}"
            )
        for name, value in zip(names, values, strict=True):
            if not math.isfinite(value):
                raise ValueError(f"state: expected finite numbers, got {name} = {value}")
        return values

    def _checked_time(self, time: float | None) -> float:
        """Return the time of a state [s]."""
        if self._state and self._is_timed != (time is not None):
            given = "had a time" if self._is_timed else "had none"
            raise ValueError(
                f"time: expected one for every state or for none, got {time}, and the last {given}"
            )
        if time is None:
            return self._time + self._problem.dt if self._state else 0.0
        now = time if type(time) is float else number_or_nan(time)
        if not (math.isfinite(now) and now >= 0.0):
            raise ValueError(f"time: expected seconds since the start of the task, got {time!r}")
        if self._state and now < self._time:
            raise ValueError(
                f"time: runs backwards, from {self._time:g} s to {now:g} s; the state is left out"
            )
        return now

    def _flags(self, values: list[float], now: float, is_first: bool) -> tuple[str, ...]:
        """Return what is odd about a state, the newest one."""
        flags = []
        dt = self._problem.dt
        if is_first:
            if now > 0.5 * dt or self._differs(values, self._start.tolist(), self._near):
                flags.append(LATE)
        elif now == self._time:
            flags.append(CONFLICTING)
        else:
            elapsed = now - self._time
            if elapsed > COARSE * dt:
                flags.append(GAP)
            reach = [
                speed * elapsed + slack
                for speed, slack in zip(self._fastest, self._jitter, strict=True)
            ]
            if self._differs(values, self._state, reach):
                flags.append(UNREACHABLE)
        for value, (low, high) in zip(values, self._bounds, strict=True):
            if not low <= value <= high:
                flags.append(OUTSIDE)
                break
        if now > (self._problem.num_steps + 0.5) * dt:
            flags.append(OVERTIME)
        return tuple(flags)

    def _differs(self, values: list[float], others: list[float], limits: list[float]) -> bool:
        """Return whether two states differ by more than limits, angles along the shorter arc."""
        for value, other, limit, is_angle in zip(
            values, others, limits, self._is_angle, strict=True
        ):
            moved = value - other
            if is_angle:
                moved -= TWO_PI * round(moved / TWO_PI)
            if abs(moved) > limit:
                return True
        return False

    def _is_forbidden(self, last: list[float], values: list[float]) -> bool:
        """Return whether the way from the last state to this one enters a known constraint."""
        problem, path = self._problem, np.array([last, values])
        return any(
            bool(violates(constraint, path, problem.space, problem.between_states))
            for constraint in problem.known
            if not constraint.about_actions
        )


def check_hypotheses(problem: ProblemRecord) -> None:
    """Raise ValueError where hypotheses are about actions: a monitor sees states alone."""
    if problem.hypotheses.about_actions:
        raise ValueError(
            "hypotheses: some are about actions, and a monitor sees states alone: leave them out"
        )


def _check_foresight(problem: ProblemRecord, foresight: Foreseer) -> None:
    """Raise ValueError where a foresight is none, or of another problem than the evidence."""
    if not (hasattr(foresight, "towards") and hasattr(foresight, "fingerprint")):
        raise ValueError(
            "foresight: expected what swerve.foresee returns, or swerve.Rollouts(nominal), got "
            f"{foresight!r}"
        )
    if foresight.fingerprint != problem.fingerprint:
        raise ValueError(
            "foresight: it is of another problem than the evidence, which is of "
            f"{problem.summary}: learn it with swerve.foresee(nominal, evidence)"
        )
