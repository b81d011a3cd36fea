"""Mutants of src/swerve/evidence."""

from __future__ import annotations

from mutants.mutant import Mutant

MUTANTS = (
    Mutant(
        "use beta twice",
        "evidence/samples.py",
        "beta=problem.beta,",
        "beta=problem.beta**2,",
        "evidence/test_samples",
    ),
    Mutant(
        "take resampled trajectories for independent ones",
        "evidence/samples.py",
        "return estimate._replace(avoid_variance=of_islands.variance())",
        "return estimate",
        "sampling/test_smc -k stated",
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
)
