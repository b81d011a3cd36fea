"""Mutants of src/swerve/solvers."""

from __future__ import annotations

from mutants.mutant import Mutant

MUTANTS = (
    Mutant(
        "drop the entropy term: PPO's reward leaves the action's log-probability out",
        "solvers/trained/ppo.py",
        "return earned - segment.log_probability - log_measure(self.problem)",
        "return earned - log_measure(self.problem)",
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
        "carry residuals over from the next episode of a lane",
        "solvers/trained/losses.py",
        "now = residual + trace * jnp.where(ended, 0.0, later)",
        "now = residual + trace * later",
        "solvers/trained/test_ppo -k advantages",
    ),
    Mutant(
        "use the same random numbers in every iteration of PPO",
        "solvers/trained/trainers.py",
        "jax.random.fold_in(jax.random.key(self.seed + 1), state.iteration)",
        "jax.random.key(self.seed + 1)",
        "solvers/trained/test_ppo -k agrees",
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
)
