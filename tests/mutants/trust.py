"""Mutants of src/swerve/trust."""

from __future__ import annotations

from mutants.mutant import Mutant

MUTANTS = (
    Mutant(
        "call a ranking settled whatever the errors of its scores",
        "trust/verdicts.py",
        "share[needs_none] = 0.0",
        "share[:] = 0.0",
        "trust/test_verdicts",
    ),
)
