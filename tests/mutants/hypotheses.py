"""Mutants of src/swerve/hypotheses."""

from __future__ import annotations

from mutants.mutant import Mutant

MUTANTS = (
    Mutant(
        "judge a step by its end alone where it crosses several lines",
        "hypotheses/stepwise.py",
        "if crossed > 1 and self._whole.between_states:",
        "if False:",
        "hypotheses/test_stepwise",
    ),
    Mutant(
        "cut windows that go round at the end of the turn",
        "hypotheses/windows.py",
        "count if goes_round else count - self.overlap + 1",
        "count - self.overlap + 1",
        "hypotheses/test_windows",
    ),
    Mutant(
        "cross a turn's end as if all lines lay between",
        "hypotheses/grid_axis.py",
        "return last + np.round(missed / TWO_PI).astype(np.int64) * self.period",
        "return last",
        "hypotheses/test_grid",
    ),
)
