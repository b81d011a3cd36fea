"""Mutants of src/swerve/inference."""

from __future__ import annotations

from mutants.mutant import Mutant

MUTANTS = (
    Mutant(
        "believe a lone trajectory that avoids what all others enter",
        "inference/scores.py",
        "is_open = evidence.standard_error > FEW_AVOID",
        "is_open = evidence.is_floored",
        "sampling/test_resolve -k lone",
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
        "keep the pick that gains less than the threshold",
        "inference/greedy.py",
        "if threshold is not None and pick.gain < threshold:",
        "if threshold is not None and picks and picks[-1].gain < threshold:",
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
        "forget what ignoring a constraint costs each demonstration that enters it",
        "inference/likelihood.py",
        "return value + entering * math.log(tolerance)",
        "return value",
        "inference/test_likelihood",
    ),
    Mutant(
        "let what lies beside a task's ends count for it",
        "inference/likelihood.py",
        "counted &= hypotheses.distance(end, space) > clear",
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
        "leave out the one island that holds all who avoid as if nothing were known",
        "inference/posterior.py",
        "np.maximum(without, least)",
        "np.where(without > 0.0, without, 1.0)",
        "inference/test_posterior -k island",
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
        "error = np.hypot(island_error, _propagated_error(value, own, _sharing(evidence)))",
        "error = island_error",
        "inference/test_posterior",
    ),
)
