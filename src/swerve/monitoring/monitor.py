"""Watch a demonstration state by state, and infer which constraint it obeys.

A demonstration that has avoided c up to its state s_t has, against no constraint, the
log-likelihood ratio

    log L_t(c) = log P_0(avoid c after t | s_t, t, goal) - log P_0(avoid c | s_0, goal).

The foresight gives the first term, the evidence the second (log Z_c / Z_0).
`Monitor._prefix_log_likelihood` computes the ratio. A demonstration that has entered c rules c out.
At the end of a demonstration nothing is left to avoid: the first term is 0, and the answer is that
of `infer`. With a tolerance eps the likelihood is eps + (1 - eps) L_t(c), or eps after c has been
entered.

Foresight cannot estimate such small probabilities as evidence can. Where the two differ widely at
the start, the foresight gives the second term too, until the end. So a demonstrator who has not
moved changes no belief.

Shapes: H hypotheses, n state dimensions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from swerve.base.arguments import instance, number_or_nan
from swerve.base.space import Task
from swerve.demonstrations.checks import unit_problem
from swerve.demonstrations.durations import first_time_hint, is_too_long
from swerve.evidence.evidence import Evidence
from swerve.hypotheses.stepwise import stepwise
from swerve.inference import likelihood
from swerve.inference.posterior import Prior, checked_prior, posterior
from swerve.monitoring.flags import AGAINST, LATE, REPEATED, UNTIMED, StateChecks
from swerve.monitoring.foresight import Foreseer
from swerve.problem.record import ProblemRecord

# nats: largest difference between log P_0(avoid c | s_0, goal) by evidence and by foresight, which
# cannot estimate a probability such as exp(-20). Above, the foresight's own value is subtracted.
AGREEMENT = 1.0
LAST_HORIZON = 1e5  # later times are of another clock, or broken: the next would come earlier


class Belief(NamedTuple):
    """The belief about the constraint after the states so far.

    Attributes:
      struck_out: [H] True where a hypothesis is ruled out; with a tolerance, entering a hypothesis
        does not rule it out.
      log_likelihood: [H] ratio against no constraint [nats]; -inf where struck out.
      none: probability that there is no constraint.
      hypotheses: [H] probability of each hypothesis.
      entered: the hypotheses that the newest state is the first to enter.
      flags: the oddities of the newest state; empty if nothing is odd.
    """

    struck_out: np.ndarray
    log_likelihood: np.ndarray
    none: float
    hypotheses: np.ndarray
    entered: tuple[int, ...]
    flags: tuple[str, ...]


class Monitor:
    """Infer which constraint one demonstrator obeys, while the demonstration lasts.

    A monitor's memory does not grow with the number of states. Use one monitor for each
    demonstrator. Do not write to the arrays that a monitor returns.

    Args:
      evidence: the evidence that `infer` would use.
      task: start and goal of the demonstration, one of the tasks of the evidence.
      foresight: foresight from `swerve.foresee`, or `swerve.Rollouts` of the nominal distribution.
      prior: as for `infer`.
      tolerance: as for `infer`.
      margin: as for `infer`.
      clearance: as for `infer`.

    Raises:
      ValueError: if an argument is of the wrong kind or range, hypotheses are about actions, there
        is no evidence for the task, or the foresight is of another problem, or was not learned for
        the goal.
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
        start = np.asarray(evidence.tasks.start[number], float)
        self._goal = np.asarray(evidence.tasks.goal[number], float)
        self._ahead = foresight.towards(evidence.tasks.goal[number])
        self._judged = hypotheses if margin is None else hypotheses.eroded(margin, space)
        self._steps = stepwise(hypotheses, self._judged, space, problem.between_states)
        self._checks = StateChecks(evidence, number)
        self._clearance = clearance
        self._entered = np.zeros(len(hypotheses), bool)
        with np.errstate(divide="ignore"):
            log_prior = np.log(self._prior)
        self._log_prior_none = float(log_prior[0])
        self._log_prior = log_prior[1:].astype(np.float32)
        # call the foresight now: its first call takes longest, and the demonstrator does not wait
        self._begin(start, evidence.log_ratio[number], self._ahead(start, 0))
        self._array = np.empty(len(space.names))
        self._believable = space.believable.T.tolist()
        self._state: list[float] = []
        self._time, self._is_timed = 0.0, False
        self._last: Belief | None = None

    def observe(self, state: Sequence[float] | np.ndarray, time: float | None = None) -> Belief:
        """Take in the next state and return the belief after all states so far.

        Args:
          state: [n]; angles may be wrapped or not.
          time: since the task's start [s]. None puts the first state at the start and each further
            state one step of the model after the last. Either all states have a time, or no state
            has.

        Returns:
          The belief, with flags that say what is odd about this state: the state comes first but is
          not the task's start (earlier states are then unknown); the state lies outside the bounds
          or in a known constraint; the state cannot be reached from the last state in the time
          between them; the state repeats the last state (which changes nothing) or contradicts it;
          more than a step and a half lies between the two states; the times seem to be of another
          unit, in which the states are about a step apart; the state is later than the horizon;
          or the states move against the dynamics, perhaps at another rate if they have no times.

        Raises:
          ValueError: if the state is not n finite numbers, or is so far outside the bounds that its
            unit must be wrong; or the time is not finite, is negative, is LAST_HORIZON horizons or
            later, is `durations.MAX_HORIZONS` horizons after the last state, runs backwards, or is
            given for some states only: then the monitor has not changed. Or if no answer that the
            prior allows is left, or the foresight gives NaN: then the state has been taken in.
        """
        values = self._checked(state)
        now, is_first = self._checked_time(time), not self._state
        if self._last is not None and now == self._time and values == self._state:
            return self._last._replace(entered=(), flags=(REPEATED,))
        if is_first:
            flags = self._checks.of_first(values, now)
        else:
            flags = self._checks.of_next(values, now, self._state, self._time)
        flags += (UNTIMED,) * (time is None and AGAINST in flags)
        entered = self._steps.enter(values)  # nothing has changed if this or an earlier line fails
        self._array[:] = values
        self._state, self._time, self._last = values, now, None
        self._is_timed = time is not None
        step = min(round(now / self._problem.dt), self._problem.num_steps)
        if is_first and LATE in flags:
            num = len(self._entered)
            foreseen = np.zeros(num) if self._is_over(step) else self._ahead(self._array, step)
            self._begin(self._array, foreseen, foreseen)
        new = tuple(k for k in entered if self._is_counted[k] and not self._entered[k])
        if new:
            self._entered[list(new)] = True
        struck_out = self._struck_out()
        log_likelihood = self._prefix_log_likelihood(step, struck_out)
        self._last = self._belief(log_likelihood, struck_out, new, flags)
        return self._last

    @property
    def is_new(self) -> bool:
        """Whether no state has come yet."""
        return not self._state

    def finish(self) -> Belief:
        """Return the belief if the demonstration ends here, which is the answer of `infer`.

        The belief is flagged as cut short where nominal trajectories take longer.

        Raises:
          ValueError: if no state has come yet, or no answer that the prior allows is left.
        """
        if not self._state:
            raise ValueError("finish: no state of the demonstration has come yet")
        value = likelihood.avoiding_term(self._log_ratio, self._tolerance)
        entering = math.log(self._tolerance) if self._tolerance else -math.inf
        value = np.where(self._entered, entering, value)
        value[self._impossible] = -np.inf
        probability = posterior(value, self._prior)
        return Belief(
            np.isneginf(value),
            value,
            float(probability[0]),
            probability[1:],
            entered=(),
            flags=self._checks.of_end(self._time),
        )

    def _begin(self, state: np.ndarray, log_ratio: np.ndarray, foreseen: np.ndarray) -> None:
        """Set log P_0(avoid c) for demonstrations that begin in a state [n].

        Args:
          state: the first state.
          log_ratio: [H] log P_0(avoid c) by the evidence, nats; -inf where no trajectory can avoid
            c.
          foreseen: [H] log P_0(avoid c) by the foresight, nats.
        """
        task = Task(state[None], self._goal[None])
        counted = likelihood.is_counted(self._problem, task, self._clearance, self._judged)[0]
        self._is_counted, self._not_counted = counted, None if counted.all() else ~counted
        self._impossible = np.isneginf(log_ratio) & counted
        known = np.where(counted & ~self._impossible, log_ratio.astype(float), 0.0)
        is_far = counted & np.isfinite(foreseen) & (np.abs(foreseen - known) > AGREEMENT)
        self._log_ratio = known
        self._at_start = np.where(is_far, foreseen, known).astype(np.float32)

    def _is_over(self, step: int) -> bool:
        """Return whether a step is the horizon, where nothing is left to avoid."""
        return step == self._problem.num_steps

    def _struck_out(self) -> np.ndarray:
        """Return [H] True where ruled out; with a tolerance, entering does not rule out."""
        return self._impossible.copy() if self._tolerance else self._entered | self._impossible

    def _prefix_log_likelihood(self, step: int, struck_out: np.ndarray) -> np.ndarray:
        """Return log L_t(c) [H], nats, of the states up to a step; -inf where struck out [H].

        See the module's docstring for the formula, and `infer` for a finished demonstration.
        """
        if self._is_over(step):
            value = -self._log_ratio.astype(np.float32)
        else:
            ahead = self._ahead(self._array, step)
            value = np.subtract(ahead, self._at_start, dtype=np.float32)
        if self._not_counted is not None:
            value[self._not_counted] = 0.0
        if self._tolerance:
            value += math.log1p(-self._tolerance)
            value[self._entered] = -np.inf
            np.logaddexp(value, np.float32(math.log(self._tolerance)), out=value)
        np.copyto(value, -np.inf, where=struck_out)
        return value

    def _belief(
        self,
        log_likelihood: np.ndarray,
        struck_out: np.ndarray,
        entered: tuple[int, ...],
        flags: tuple[str, ...],
    ) -> Belief:
        """Return the belief by Bayes' rule: prior times L_t, divided by their sum."""
        joint = log_likelihood + self._log_prior
        largest = max(float(joint.max()), self._log_prior_none)  # NaN if a value is NaN
        if math.isnan(largest):
            raise ValueError(
                f"foresight: gave NaN for {self._state} at {self._time:g} s: learn the foresight "
                "again, or correct it"
            )
        if largest == -math.inf:
            raise ValueError(
                "prior: the states so far rule out every hypothesis, and P(no constraint) is 0: "
                "give it some probability, or the monitor a tolerance"
            )
        joint -= np.float32(largest)
        np.exp(joint, out=joint)
        none = math.exp(self._log_prior_none - largest)
        total = none + float(joint.sum())
        joint /= np.float32(total)
        for array in (struck_out, log_likelihood, joint):
            array.setflags(write=False)
        return Belief(struck_out, log_likelihood, none / total, joint, entered, flags)

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
        for column, (value, (low, high)) in enumerate(zip(values, self._believable, strict=True)):
            if not math.isfinite(value):
                raise ValueError(f"state: expected finite numbers, got {names[column]} = {value}")
            if not low <= value <= high:
                raise ValueError(f"state: {unit_problem(value, self._problem.space, column)}")
        return values

    def _checked_time(self, time: float | None) -> float:
        """Return the time of a state [s]."""
        if self._state and self._is_timed != (time is not None):
            given = "had a time" if self._is_timed else "had none"
            raise ValueError(
                "time: expected a time for every state or for none, got "
                f"{time}, and the last {given}"
            )
        if time is None:
            return self._time + self._problem.dt if self._state else 0.0
        now = time if type(time) is float else number_or_nan(time)
        if not (math.isfinite(now) and now >= 0.0):
            raise ValueError(f"time: expected seconds since the start of the task, got {time!r}")
        horizon = self._problem.num_steps * self._problem.dt
        elapsed = now - self._time if self._state else now
        is_late = self._problem.is_timed and is_too_long(elapsed, horizon)
        if is_late or now >= LAST_HORIZON * horizon:
            hint = self._checks.late_hint if self._state else first_time_hint
            raise ValueError(
                f"time: expected seconds since the start of the task, got {now:g} s, where the "
                f"horizon is {horizon:g} s; this state is ignored{hint(elapsed, horizon)}"
            )
        if self._state and now < self._time:
            raise ValueError(
                f"time: runs backwards, from {self._time:g} s to {now:g} s; this state is ignored"
            )
        return now


def check_hypotheses(problem: ProblemRecord) -> None:
    """Raise ValueError where hypotheses are about actions: a monitor sees states alone."""
    if problem.hypotheses.about_actions:
        raise ValueError(
            "hypotheses: some are about actions, and a monitor sees states alone: leave them out"
        )


def _check_foresight(problem: ProblemRecord, foresight: Foreseer) -> None:
    """Raise ValueError where a foresight is of the wrong kind, or not of the evidence's problem."""
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
