"""Mutants of src/swerve/sampling."""

from __future__ import annotations

from mutants.mutant import Mutant

MUTANTS = (
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
        "believe a ratio that so many samples contradict",
        "sampling/resolve.py",
        "return sum(terms) > UNLIKELY and 1.0 - sum(terms[:-1]) > UNLIKELY",
        "return sum(terms) > UNLIKELY",
        "sampling/test_resolve -k held",
    ),
    Mutant(
        "count what was entered before a state for the rest",
        "sampling/labelled_states.py",
        "part = states[:, cut : end + 1]",
        "part = states[:, : end + 1]",
        "monitoring/test_foresight -k every_sequence",
    ),
    Mutant(
        "find nothing missing that resampling kills",
        "sampling/missed.py",
        "        scarcity = ahead.max(axis=0) - log_partition",
        "        scarcity = ahead.min(axis=0) - log_partition",
        "sampling/test_missed -k never_does",
    ),
    Mutant(
        "let explorers weigh themselves by the policy",
        "sampling/missed.py",
        "    now = Explored(earned - log_q, ",
        "    now = Explored(policy_gain, ",
        "sampling/test_missed -k exactly",
    ),
)
