"""Mutants of src/swerve/monitoring."""

from __future__ import annotations

from mutants.mutant import Mutant

MUTANTS = (
    Mutant(
        "believe what foresight cannot tell of who has not moved",
        "monitoring/monitor.py",
        "self._at_start = np.where(is_far, foreseen, known)",
        "self._at_start = known",
        "monitoring/test_monitor -k not_moved",
    ),
    Mutant(
        "foresee starts by rollouts alone",
        "monitoring/foresee.py",
        "return (sampled + START_WEIGHT * known) / num_hypotheses",
        "return sampled / num_hypotheses",
        "monitoring/test_foresight -k starts",
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
        "foresee as if no time had passed",
        "monitoring/foresight.py",
        "np.add(value, self._table[step], out=value)",
        "np.add(value, self._table[0], out=value)",
        "monitoring/test_foresight -k one_state",
    ),
)
