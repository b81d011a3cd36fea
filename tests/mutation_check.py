"""Break the library on purpose, one place at a time, and see that a test notices.

    python tests/mutation_check.py [--write docs/testing.md]

Each mutant replaces one piece of text in a copy of the sources and runs one test module, stopping
at its first failure. A mutant that survives is a hole in the tests: the exit status is then 1. The
table of docs/testing.md between the two markers is what --write writes.
"""

from __future__ import annotations

import argparse
import functools
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
TIMEOUT = 900.0  # s
MARKERS = "<!-- mutants -->\n", "<!-- end of mutants -->\n"


class Mutant(NamedTuple):
    """One place where the library is broken.

    Attributes:
      what: is done wrong.
      file: in src/swerve.
      right: text, found there exactly once.
      wrong: what stands there instead.
      tests: a test module, with -k as in "test_space -k difference".
    """

    what: str
    file: str
    right: str
    wrong: str
    tests: str


MUTANTS = (
    Mutant(
        "drop the entropy term: PPO's reward leaves the action's log-probability out",
        "solvers/trained/ppo.py",
        "reward = earned - segment.log_probability - log_measure(self.problem)",
        "reward = earned - log_measure(self.problem)",
        "solvers/trained/test_ppo -k entropy",
    ),
    Mutant(
        "drop the entropy of the tabular value: the best action in place of the log-sum",
        "solvers/exact/table.py",
        "return finite + np.log(np.exp(values - finite[:, None]).sum(axis=-1))",
        "return largest",
        "solvers/exact/test_tabular",
    ),
    Mutant(
        "forget to wrap angles",
        "base/space.py",
        "wrapped = delta - TWO_PI * xp.round(delta / TWO_PI)",
        "wrapped = delta",
        "base/test_space",
    ),
    Mutant(
        "count one step too many (the start state twice)",
        "simulation/trajectory.py",
        "carry.length + active,",
        "carry.length + active + (step == 0),",
        "simulation/test_trajectory",
    ),
    Mutant(
        "use beta twice",
        "evidence/samples.py",
        "beta=problem.beta,",
        "beta=problem.beta**2,",
        "evidence/test_samples",
    ),
    Mutant(
        "ignore early termination",
        "simulation/trajectory.py",
        "ended = mdp.terminated(next_state, goal) | (step == mdp.num_steps - 1)",
        "ended = step == mdp.num_steps - 1",
        "simulation/test_trajectory",
    ),
    Mutant(
        "pay the terminal reward at the horizon alone",
        "simulation/trajectory.py",
        "jnp.where(ended, mdp.terminal_reward(next_state, goal), 0.0)",
        "jnp.where(step == mdp.num_steps - 1, mdp.terminal_reward(next_state, goal), 0.0)",
        "simulation/test_trajectory",
    ),
    Mutant(
        "forget the base measure in soft values",
        "simulation/policies.py",
        'math.log(problem.mdp.num_actions) if problem.measure == "uniform" else 0.0',
        "0.0",
        "solvers/grid/test_grid -k soft_value",
    ),
    Mutant(
        "look ahead past the end of an episode",
        "simulation/policies.py",
        "ahead = jnp.where(taken.ended, 0.0, self.value(taken.state, step + 1, goal))",
        "ahead = self.value(taken.state, step + 1, goal)",
        "solvers/grid/test_grid -k early_termination",
    ),
    Mutant(
        "carry residuals over from the next episode of a lane",
        "solvers/trained/losses.py",
        "now = residual + trace * jnp.where(ended, 0.0, later)",
        "now = residual + trace * later",
        "solvers/trained/test_ppo -k advantages",
    ),
    Mutant(
        "resample without keeping the mean of the weights",
        "sampling/smc.py",
        "return (particles, log_mean + mean), (",
        "return (particles, log_mean), (",
        "sampling/test_smc -k bias",
    ),
    Mutant(
        "follow the survivors back without their ancestors",
        "sampling/smc.py",
        "return ancestor[index], (",
        "return index, (",
        "sampling/test_smc -k followed",
    ),
    Mutant(
        "expect something of particles whose episode has ended",
        "sampling/smc.py",
        "gain = particles.owed + jnp.where(particles.ended, 0.0, proposed[1])",
        "gain = particles.owed + proposed[1]",
        "sampling/test_smc -k bias",
    ),
    Mutant(
        "accept every trajectory that is grown anew",
        "sampling/tempering.py",
        "accepted = proposed > threshold",
        "accepted = threshold < np.inf",
        "sampling/test_tempering -k enumeration",
    ),
    Mutant(
        "forget what a resampling between temperatures was worth",
        "sampling/tempering.py",
        "self.log_mean = self.log_mean + np.log(total / num) + largest[:, 0]",
        "self.log_mean = self.log_mean + np.log(total / num)",
        "sampling/test_tempering -k enumeration",
    ),
    Mutant(
        "take Z_c for the ratio of Z_c and Z_0",
        "sampling/resolve.py",
        "found = avoiding.log_partition[0] - evidence.log_partition[k]",
        "found = avoiding.log_partition[0]",
        "sampling/test_resolve -k grid",
    ),
    Mutant(
        "believe a lone trajectory that avoids what all others enter",
        "inference/scores.py",
        "is_open = evidence.standard_error > FEW_AVOID",
        "is_open = evidence.is_floored",
        "sampling/test_resolve -k lone",
    ),
    Mutant(
        "believe a ratio that so many samples contradict",
        "sampling/resolve.py",
        "return sum(terms) > UNLIKELY and 1.0 - sum(terms[:-1]) > UNLIKELY",
        "return sum(terms) > UNLIKELY",
        "sampling/test_resolve -k held",
    ),
    Mutant(
        "call a ranking settled whatever the errors of its scores",
        "trust/verdicts.py",
        "share[needs_none] = 0.0",
        "share[:] = 0.0",
        "trust/test_verdicts",
    ),
    Mutant(
        "look ahead with the problem's beta whatever beta is asked for",
        "simulation/policies.py",
        "self.beta * reward + ahead",
        "problem.beta * reward + ahead",
        "solvers/trained/test_soft_value -k span",
    ),
    Mutant(
        "take resampled trajectories for independent ones",
        "evidence/samples.py",
        "            estimate = estimate._replace(avoid_variance=of_islands.variance())",
        "            pass",
        "sampling/test_smc -k stated",
    ),
    Mutant(
        "judge the states alone where segments count",
        "constraints/base.py",
        "hit = constraint.crosses(starts, ends, space)",
        "hit = constraint.contains(ends, space)",
        "constraints/test_base",
    ),
    Mutant(
        "close the upper side of a box",
        "constraints/boxes.py",
        "(low <= value) & (value < high)\n        return inside\n\n    def crosses",
        "(low <= value) & (value <= high)\n        return inside\n\n    def crosses",
        "constraints/test_boxes",
    ),
    Mutant(
        "let trajectories through known constraints",
        "simulation/trajectory.py",
        "return Step(next_state, jnp.where(forbidden, -jnp.inf, reward), ended | forbidden)",
        "return Step(next_state, reward, ended)",
        "simulation/test_trajectory",
    ),
    Mutant(
        "draw the action before the one that the uniform number falls on",
        "simulation/trajectory.py",
        "action = jnp.sum(uniform * cumulative[-1] >= cumulative[:-1])",
        "action = jnp.maximum(jnp.sum(uniform * cumulative[-1] >= cumulative[:-1]) - 1, 0)",
        "simulation/test_trajectory",
    ),
    Mutant(
        "strike a hypothesis out only when every demonstration enters it",
        "inference/scores.py",
        "return np.asarray((self.counts.entering > 0).any(axis=0)) | self.impossible",
        "return np.asarray((self.counts.avoiding == 0).all(axis=0)) | self.impossible",
        "inference/test_ranking",
    ),
    Mutant(
        "count each task once, however many demonstrations it has",
        "inference/scores.py",
        "return np.bincount(self.task_of, minlength=self.evidence.num_tasks)",
        "return np.minimum(np.bincount(self.task_of, minlength=self.evidence.num_tasks), 1)",
        "inference/test_ranking",
    ),
    Mutant(
        "use the same random numbers in every iteration of PPO",
        "solvers/trained/trainers.py",
        "jax.random.fold_in(jax.random.key(self.seed + 1), state.iteration)",
        "jax.random.key(self.seed + 1)",
        "solvers/trained/test_ppo -k agrees",
    ),
    Mutant(
        "keep the pick that gains less than the threshold",
        "inference/greedy.py",
        "if pick is None or pick.gain < max(threshold, TIED):",
        "if pick is None or (picks and picks[-1].gain < max(threshold, TIED)):",
        "inference/test_greedy_steps",
    ),
    Mutant(
        "leave out trajectories again that were left out before",
        "inference/conditional.py",
        "entering, self._rows = self._rows[enters], self._rows[~enters]",
        "entering, self._rows = self._rows[enters], self._rows",
        "inference/test_greedy",
    ),
    Mutant(
        "let a demonstration that ignores one pick count for the next",
        "inference/greedy.py",
        "self._is_obeyed &= ~enters",
        "self._is_obeyed &= True",
        "inference/test_greedy",
    ),
    Mutant(
        "rule out pairs that may be the best",
        "inference/pairs.py",
        "share = 1.0 - self._entered[k, rows] - self._entered[k, columns].max()",
        "share = 1.0 - self._entered[k, rows]",
        "inference/test_pairs",
    ),
    Mutant(
        "forget the rewards of all but the last step for which an action is held",
        "solvers/exact/discrete.py",
        "earned = earned + jnp.where(ended, 0.0, reward)",
        "earned = jnp.where(ended, earned, reward)",
        "solvers/exact/test_discrete -k held",
    ),
    Mutant(
        "carry on with what has entered a hypothesis",
        "solvers/exact/table.py",
        "clean = self.arrivals @ np.where(stays, moved, 0.0)",
        "clean = self.arrivals @ moved",
        "solvers/exact/test_tabular",
    ),
    Mutant(
        "weigh all trajectories alike where weights are asked for",
        "evidence/samples.py",
        'if method != "plain":',
        "if False:",
        "evidence/test_samples",
    ),
    Mutant(
        "keep equal weights equal at another beta",
        "evidence/samples.py",
        "shift = (problem.beta - sampling_beta) * np.where(",
        "shift = 0.0 * np.where(",
        "evidence/test_at_beta -k theorem_2",
    ),
    Mutant(
        "fit beta as if each task had one demonstration",
        "fitting/beta.py",
        "float(self.earned - counts @ mean[:, 0]),",
        "float(self.earned - mean.sum()),",
        "fitting/test_beta -k score",
    ),
    Mutant(
        "forget what ignoring a constraint costs each demonstration that enters it",
        "inference/likelihood.py",
        "return value + entering * math.log(tolerance)",
        "return value",
        "inference/test_likelihood",
    ),
    Mutant(
        "let what lies beside a task's ends count for it",
        "inference/likelihood.py",
        "counted &= hypotheses.distance(end, space) > float(clearance)",
        "counted &= hypotheses.distance(end, space) > -1.0",
        "inference/test_likelihood",
    ),
    Mutant(
        "let a demonstration obey what its task ends in, by a margin",
        "inference/likelihood.py",
        "~(whole.contains(end, space) & ~eroded.contains(end, space))",
        "True",
        "inference/test_likelihood",
    ),
    Mutant(
        "believe what foresight cannot tell of who has not moved",
        "monitoring/monitor.py",
        "self._at_start = np.where(is_far, foreseen, known)",
        "self._at_start = known",
        "monitoring/test_monitor -k not_moved",
    ),
    Mutant(
        "leave out the one island that holds all who avoid as if nothing were known",
        "inference/posterior.py",
        "np.maximum(without, evidence.resolution[tasks][:, None])",
        "np.where(without > 0.0, without, 1.0)",
        "inference/test_posterior -k island",
    ),
    Mutant(
        "foresee starts by rollouts alone",
        "monitoring/foresee.py",
        "return (sampled + START_WEIGHT * known) / num_hypotheses",
        "return sampled / num_hypotheses",
        "monitoring/test_foresight -k starts",
    ),
    Mutant(
        "judge a task by its start alone where its goal is a state too",
        "inference/likelihood.py",
        "ends.append(np.asarray(tasks.goal, float))",
        "pass",
        "inference/test_likelihood",
    ),
    Mutant(
        "take no constraint for one more hypothesis",
        "inference/posterior.py",
        "        prior = NONE\n",
        "        prior = 1.0 / (num_hypotheses + 1)\n",
        "inference/test_posterior",
    ),
    Mutant(
        "forget the prior",
        "inference/posterior.py",
        "log_joint = np.concatenate([none, log_likelihood], axis=-1) + log_prior",
        "log_joint = np.concatenate([none, log_likelihood], axis=-1) + 0.0 * prior",
        "inference/test_posterior",
    ),
    Mutant(
        "take values without one island for independent estimates",
        "inference/posterior.py",
        "return np.sqrt((num - 1) * replicates.var(axis=0))",
        "return np.sqrt(replicates.var(axis=0) / num)",
        "inference/test_posterior",
    ),
    Mutant(
        "fill a credible set with the least probable answers",
        "inference/posterior.py",
        'order = np.argsort(-probabilities, kind="stable")',
        'order = np.argsort(probabilities, kind="stable")',
        "inference/test_posterior",
    ),
    Mutant(
        "forget the errors of ratios worked out with the constraint in force",
        "inference/posterior.py",
        "error = np.hypot(island_error, _propagated_error(value, (own**2).sum(axis=0)))",
        "error = island_error",
        "inference/test_posterior",
    ),
    Mutant(
        "forget what it was worth to avoid a hypothesis so far",
        "monitoring/monitor.py",
        "value = np.subtract(ahead, self._at_start, dtype=np.float32)",
        "value = np.add(ahead, 0.0, dtype=np.float32)",
        "monitoring/test_monitor",
    ),
    Mutant(
        "hold a late start against all that came before it",
        "monitoring/monitor.py",
        "if is_first and LATE in flags:",
        "if False:",
        "monitoring/test_monitor",
    ),
    Mutant(
        "go on with what is foreseen at the horizon, where nothing is left",
        "monitoring/monitor.py",
        "return step == self._problem.num_steps",
        "return False",
        "monitoring/test_monitor",
    ),
    Mutant(
        "let time run backwards",
        "monitoring/monitor.py",
        "if self._state and now < self._time:",
        "if False:",
        "monitoring/test_monitor",
    ),
    Mutant(
        "judge a step by its end alone where it crosses several lines",
        "hypotheses/stepwise.py",
        "if crossed > 1 and self._whole.between_states:",
        "if False:",
        "monitoring/test_monitor",
    ),
    Mutant(
        "foresee as if no time had passed",
        "monitoring/foresight.py",
        "np.add(value, self._table[step], out=value)",
        "np.add(value, self._table[0], out=value)",
        "monitoring/test_foresight -k one_state",
    ),
    Mutant(
        "learn from a coarse policy without its weights",
        "simulation/continuation.py",
        "return Continuation(states, left - values)",
        "return Continuation(states, 0.0 * left)",
        "monitoring/test_foresight -k coarse",
    ),
    Mutant(
        "count what was entered before a state for the rest",
        "sampling/continuations.py",
        "part = states[:, cut : end + 1]",
        "part = states[:, : end + 1]",
        "monitoring/test_foresight -k every_sequence",
    ),
    Mutant(
        "cut windows that go round at the end of the turn",
        "hypotheses/windows.py",
        "count if goes_round else count - self.overlap + 1",
        "count - self.overlap + 1",
        "hypotheses/test_windows",
    ),
    Mutant(
        "forbid actions everywhere, whatever the state they are begun in",
        "constraints/state_action.py",
        "return self.states.contains(states, space) & self.actions.forbids(actions)",
        "return self.actions.forbids(actions)",
        "constraints/test_state_action",
    ),
    Mutant(
        "look at a map at the two ends of a step alone",
        "constraints/occupancy.py",
        "for k in range(1, int(count)):",
        "for k in range(1, 1):",
        "systems/test_walker",
    ),
    Mutant(
        "take back the steps into a hypothesis without the walks that came twice",
        "solvers/exact/walks.py",
        "kernel = np.linalg.solve(np.eye(size) + taken @ between, taken)",
        "kernel = taken",
        "solvers/exact/test_soft_paths",
    ),
    Mutant(
        "let walks go on from where they end",
        "solvers/exact/walks.py",
        "weight[is_end[self.steps.source]] = 0.0",
        "pass",
        "solvers/exact/test_soft_paths",
    ),
    Mutant(
        "let a demonstration begin elsewhere than its task",
        "demonstrations/batch.py",
        "if not (is_there.all() and are_plausible(states, space)):",
        "if not are_plausible(states, space):",
        "inference/test_judging",
    ),
    Mutant(
        "rest at the start rather than where a shorter demonstration ends",
        "demonstrations/batch.py",
        "return states[np.minimum(np.arange(num), len(states) - 1)]",
        "return states[np.arange(num) % len(states)]",
        "inference/test_judging",
    ),
    Mutant(
        "cross a turn's end as if all lines lay between",
        "hypotheses/grid_axis.py",
        "return last + np.round(missed / TWO_PI).astype(np.int64) * self.period",
        "return last",
        "hypotheses/test_grid",
    ),
)


def caught_by(mutant: Mutant) -> str | None:
    """Return the first test that fails on a mutant, or None if it survives.

    Raises:
      ValueError: if the text to replace is not there exactly once, or tests fail without it.
    """
    if first_failure(mutant.tests, ROOT / "src") is not None:
        raise ValueError(f"{mutant.tests}: fails on the library as it is")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "src"
        shutil.copytree(ROOT / "src", copy)
        path = copy / "swerve" / mutant.file
        text = path.read_text()
        if text.count(mutant.right) != 1:
            raise ValueError(
                f"{mutant.file}: expected once, found {text.count(mutant.right)} times:"
                f" {mutant.right!r}"
            )
        path.write_text(text.replace(mutant.right, mutant.wrong))
        return first_failure(mutant.tests, copy)


@functools.cache
def first_failure(tests: str, sources: Path) -> str | None:
    """Return the first test that fails on some sources, or None."""
    module, *options = tests.split()
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [*command, "-W", "default", f"tests/{module}.py", *options],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(sources)},
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT,
    )
    failed = re.search(r"^FAILED tests/(\S+)", done.stdout, re.MULTILINE)
    if done.returncode and not failed:
        raise ValueError(f"{tests}: no test failed, and yet:\n{done.stdout[-2000:]}")
    return failed[1] if failed else None


def main() -> None:
    """Try every mutant and print which test catches it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--write", type=Path, help="page whose table to write")
    page = parser.parse_args().write
    rows = ["| what is done wrong | where | caught by |", "|---|---|---|"]
    survivors = 0
    for mutant in MUTANTS:
        test = caught_by(mutant)
        survivors += test is None
        print(f"{'SURVIVES' if test is None else 'caught'}: {mutant.what} [{mutant.file}] {test}")
        rows.append(f"| {mutant.what} | `{mutant.file}` | `{test}` |")
    print(f"{len(MUTANTS) - survivors} of {len(MUTANTS)} mutants caught")
    if page is not None:
        first, last = MARKERS
        before, _, rest = page.read_text().partition(first)
        after = rest.partition(last)[2]
        page.write_text(before + first + "\n".join(rows) + "\n" + last + after)
    sys.exit(1 if survivors else 0)


if __name__ == "__main__":
    main()
