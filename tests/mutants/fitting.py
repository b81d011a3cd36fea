"""Mutants of src/swerve/fitting."""

from __future__ import annotations

from mutants.mutant import Mutant

MUTANTS = (
    Mutant(
        "fit beta as if each task had one demonstration",
        "fitting/beta.py",
        "float(self.earned - counts @ mean[:, 0]),",
        "float(self.earned - mean.sum()),",
        "fitting/test_beta -k score",
    ),
    Mutant(
        "take the action at the first instant of a step",
        "fitting/steps.py",
        "actions = actions[_row_before(middle - slack, elapsed)]",
        "actions = actions[_row_before(wanted[:-1] + slack, elapsed)]",
        "fitting/test_divergence -k vary",
    ),
    Mutant(
        "count the rows after the end of an episode",
        "fitting/steps.py",
        "        return int(ended.argmax()) + 1",
        "        return len(path)",
        "fitting/test_rewards -k after_the_end",
    ),
)
