"""Mutants of src/swerve/demonstrations."""

from __future__ import annotations

from mutants.mutant import Mutant

MUTANTS = (
    Mutant(
        "let a demonstration begin elsewhere than its task",
        "demonstrations/batch.py",
        "if not (is_there.all() and are_plausible(states, space)):",
        "if not are_plausible(states, space):",
        "inference/test_judging",
    ),
    Mutant(
        "rest at the start rather than where a shorter demonstration ends",
        "demonstrations/batch.py",
        "return states[np.minimum(np.arange(num), len(states) - 1)]",
        "return states[np.arange(num) % len(states)]",
        "inference/test_judging",
    ),
)
