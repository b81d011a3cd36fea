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
)
