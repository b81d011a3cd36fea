"""Mutants of src/swerve/base."""

from __future__ import annotations

from mutants.mutant import Mutant

MUTANTS = (
    Mutant(
        "forget to wrap angles",
        "base/space.py",
        "wrapped = delta - TWO_PI * xp.round(delta / TWO_PI)",
        "wrapped = delta",
        "base/test_space",
    ),
)
